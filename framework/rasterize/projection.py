"""Gaussians -> screen, and the gradient back: kernels over blocks of Gaussians.

A projected Gaussian is one row of 16 floats (a cache line): 0-1 mean u, v [px]; 2-4 -A/2, -B, -C/2
times log2(e); 5 log2(opacity); 6-8 colour; 9 depth; 10-11 half-sides of the box that holds all
alpha >= 1/255 [px], -1 if culled; 12 opacity; 13-15 conic A, B, C (inverse 2D covariance).
With it the blending kernels get alpha = 2^(row[5] + row[2] dx^2 + row[3] dx dy + row[4] dy^2).

Camera row (float32[20]): rotation (9), translation (3), centre (3), fx, fy, cx, cy, near.
EWA splatting (Zwicker et al. 2001) as in 3DGS, spherical harmonics with its signs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.jit import inlined, kernel
from framework.rasterize.constants import ALPHA_MIN, DILATION, FRUSTUM_MARGIN
from framework.rasterize.simd import load, store, zeros

f4 = np.float32

_LOG2E = f4(1.4426950408889634)
_CUT = f4(ALPHA_MIN)
_DILATION = f4(DILATION)
_REACH = f4(0.5 + FRUSTUM_MARGIN)
_HUGE = f4(1e30)

# normalisation of the real spherical harmonics up to degree 3
Y0 = f4(0.28209479177387814)
_Y1 = f4(0.4886025119029199)
_Y2A, _Y2B, _Y2C = f4(1.0925484305920792), f4(0.31539156525252005), f4(0.5462742152960396)
_Y3A, _Y3B, _Y3C = f4(0.5900435899266435), f4(2.890611442640554), f4(0.4570457994644658)
_Y3D, _Y3E = f4(0.3731763325901154), f4(1.445305721320277)
ONE, TWO, THREE, FOUR, SIX, EIGHT = f4(1), f4(2), f4(3), f4(4), f4(6), f4(8)
ZERO, HALF = f4(0), f4(0.5)


@inlined
def _basis(degree: int, x: Any, y: Any, z: Any, out: Any) -> None:
    """The basis functions 1.. of `degree` at the unit direction, into out[0..]."""
    out[0] = -_Y1 * y
    out[1] = _Y1 * z
    out[2] = -_Y1 * x
    if degree > 1:
        xx, yy, zz = x * x, y * y, z * z
        out[3] = _Y2A * x * y
        out[4] = -_Y2A * y * z
        out[5] = _Y2B * (TWO * zz - xx - yy)
        out[6] = -_Y2A * x * z
        out[7] = _Y2C * (xx - yy)
        if degree > 2:
            out[8] = -_Y3A * y * (THREE * xx - yy)
            out[9] = _Y3B * x * y * z
            out[10] = -_Y3C * y * (FOUR * zz - xx - yy)
            out[11] = _Y3D * z * (TWO * zz - THREE * xx - THREE * yy)
            out[12] = -_Y3C * x * (FOUR * zz - xx - yy)
            out[13] = _Y3E * z * (xx - yy)
            out[14] = -_Y3A * x * (xx - THREE * yy)


@inlined
def _basis_gradient(degree: int, x: Any, y: Any, z: Any, d: Any) -> tuple[Any, Any, Any]:
    """Sum over the basis functions of d[k] x their gradient in (x, y, z)."""
    gx, gy, gz = -_Y1 * d[2], -_Y1 * d[0], _Y1 * d[1]
    if degree > 1:
        gx += _Y2A * (y * d[3] - z * d[6]) - TWO * _Y2B * x * d[5] + TWO * _Y2C * x * d[7]
        gy += _Y2A * (x * d[3] - z * d[4]) - TWO * _Y2B * y * d[5] - TWO * _Y2C * y * d[7]
        gz += -_Y2A * (y * d[4] + x * d[6]) + FOUR * _Y2B * z * d[5]
        if degree > 2:
            xx, yy, zz = x * x, y * y, z * z
            xy, yz, xz = x * y, y * z, x * z
            gx += -SIX * _Y3A * xy * d[8] + _Y3B * yz * d[9] + TWO * _Y3C * xy * d[10]
            gx += -SIX * _Y3D * xz * d[11] - _Y3C * (FOUR * zz - THREE * xx - yy) * d[12]
            gx += TWO * _Y3E * xz * d[13] - THREE * _Y3A * (xx - yy) * d[14]
            gy += -THREE * _Y3A * (xx - yy) * d[8] + _Y3B * xz * d[9]
            gy += -_Y3C * (FOUR * zz - xx - THREE * yy) * d[10] - SIX * _Y3D * yz * d[11]
            gy += TWO * _Y3C * xy * d[12] - TWO * _Y3E * yz * d[13] + SIX * _Y3A * xy * d[14]
            gz += _Y3B * xy * d[9] - EIGHT * _Y3C * yz * d[10]
            gz += THREE * _Y3D * (TWO * zz - xx - yy) * d[11] - EIGHT * _Y3C * xz * d[12]
            gz += _Y3E * (xx - yy) * d[13]
    return gx, gy, gz


@inlined
def to_camera(camera: Any, mean: Any) -> tuple[Any, Any, Any]:
    x = camera[0] * mean[0] + camera[1] * mean[1] + camera[2] * mean[2] + camera[9]
    y = camera[3] * mean[0] + camera[4] * mean[1] + camera[5] * mean[2] + camera[10]
    z = camera[6] * mean[0] + camera[7] * mean[1] + camera[8] * mean[2] + camera[11]
    return x, y, z


@inlined
def _direction(camera: Any, mean: Any) -> tuple[Any, Any, Any, Any]:
    """Unit direction camera -> mean, and 1 / distance."""
    x, y, z = mean[0] - camera[12], mean[1] - camera[13], mean[2] - camera[14]
    inverse = ONE / math.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse, inverse


@inlined
def unit_quat(quat: Any) -> tuple[Any, Any, Any, Any, Any]:
    """(w, x, y, z) normalised, and 1 / norm."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    inverse = ONE / math.sqrt(w * w + x * x + y * y + z * z)
    return w * inverse, x * inverse, y * inverse, z * inverse, inverse


@inlined
def rotation(w: Any, x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """Row-major rotation matrix of a unit quaternion."""
    return (
        ONE - TWO * (y * y + z * z),
        TWO * (x * y - w * z),
        TWO * (x * z + w * y),
        TWO * (x * y + w * z),
        ONE - TWO * (x * x + z * z),
        TWO * (y * z - w * x),
        TWO * (x * z - w * y),
        TWO * (y * z + w * x),
        ONE - TWO * (x * x + y * y),
    )


@inlined
def screen_axes(camera: Any, x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """T = J W, 2x3 row-major: how the projected point moves with the world point."""
    inverse = ONE / z
    jx, jy = camera[15] * inverse, camera[16] * inverse
    kx, ky = -jx * x * inverse, -jy * y * inverse
    return (
        jx * camera[0] + kx * camera[6],
        jx * camera[1] + kx * camera[7],
        jx * camera[2] + kx * camera[8],
        jy * camera[3] + ky * camera[6],
        jy * camera[4] + ky * camera[7],
        jy * camera[5] + ky * camera[8],
    )


@inlined
def times_rotation(t: Any, r: Any) -> tuple[Any, ...]:
    """U = T R, 2x3."""
    return (
        t[0] * r[0] + t[1] * r[3] + t[2] * r[6],
        t[0] * r[1] + t[1] * r[4] + t[2] * r[7],
        t[0] * r[2] + t[1] * r[5] + t[2] * r[8],
        t[3] * r[0] + t[4] * r[3] + t[5] * r[6],
        t[3] * r[1] + t[4] * r[4] + t[5] * r[7],
        t[3] * r[2] + t[4] * r[5] + t[5] * r[8],
    )


@kernel
def project(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    sh0: Any,
    shN: Any,
    factors: Any,
    offset: Any,
    degree: int,
    camera: Any,
    width: int,
    height: int,
    rows: Any,
    clipped: Any,
    bound: Any,
    radii: Any,
) -> None:
    """Fill `rows` [N, 16]; clipped [N] uint8: bit c set where colour c was clamped at 0; bound [N]
    int32: the number of tiles the box covers (0 = culled), an upper bound on those touched;
    radii [N]: the larger half-side of the box, 0 if culled."""
    n = len(means)
    basis = np.empty(15, np.float32)
    w, h = f4(width), f4(height)
    for i in range(n * block // blocks, n * (block + 1) // blocks):
        row = rows[i]
        x, y, z = to_camera(camera, means[i])
        opacity = factors[i] / (ONE + math.exp(-logits[i]))
        row[9] = z
        row[10] = -ONE
        row[11] = -ONE
        bound[i] = 0
        radii[i] = ZERO
        if not (z >= camera[19] and opacity >= _CUT):
            continue
        u = camera[15] * x / z + camera[17]
        v = camera[16] * y / z + camera[18]
        if not (abs(u - HALF * w) <= _REACH * w and abs(v - HALF * h) <= _REACH * h):
            continue
        u += offset[i, 0]
        v += offset[i, 1]
        t = screen_axes(camera, x, y, z)
        qw, qx, qy, qz, _ = unit_quat(quats[i])
        m = times_rotation(t, rotation(qw, qx, qy, qz))
        s0, s1, s2 = (
            math.exp(log_scales[i, 0]),
            math.exp(log_scales[i, 1]),
            math.exp(log_scales[i, 2]),
        )
        a0, a1, a2 = m[0] * s0, m[1] * s1, m[2] * s2
        b0, b1, b2 = m[3] * s0, m[4] * s1, m[5] * s2
        xx = a0 * a0 + a1 * a1 + a2 * a2
        xy = a0 * b0 + a1 * b1 + a2 * b2
        yy = b0 * b0 + b1 * b1 + b2 * b2
        # xx yy - xy^2 would cancel for long, thin Gaussians and leave an indefinite conic
        c01, c02, c12 = a0 * b1 - a1 * b0, a0 * b2 - a2 * b0, a1 * b2 - a2 * b1
        determinant = c01 * c01 + c02 * c02 + c12 * c12 + _DILATION * (xx + yy + _DILATION)
        if not (determinant > ZERO and determinant < _HUGE):  # also where parameters are not finite
            continue
        xx += _DILATION
        yy += _DILATION
        inverse = ONE / determinant
        red, green, blue = (
            HALF + Y0 * sh0[i, 0, 0],
            HALF + Y0 * sh0[i, 0, 1],
            HALF + Y0 * sh0[i, 0, 2],
        )
        if degree > 0:
            dx, dy, dz, _ = _direction(camera, means[i])
            _basis(degree, dx, dy, dz, basis)
            for k in range((degree + 1) * (degree + 1) - 1):
                red += basis[k] * shN[i, k, 0]
                green += basis[k] * shN[i, k, 1]
                blue += basis[k] * shN[i, k, 2]
        clipped[i] = (
            (1 if red < ZERO else 0) | (2 if green < ZERO else 0) | (4 if blue < ZERO else 0)
        )
        row[0] = u
        row[1] = v
        row[2] = -HALF * _LOG2E * yy * inverse
        row[3] = _LOG2E * xy * inverse
        row[4] = -HALF * _LOG2E * xx * inverse
        row[5] = math.log(opacity) * _LOG2E
        row[6] = max(red, ZERO)
        row[7] = max(green, ZERO)
        row[8] = max(blue, ZERO)
        reach = TWO * math.log(f4(255) * opacity)
        rx, ry = math.sqrt(reach * xx), math.sqrt(reach * yy)
        row[12] = opacity
        row[13] = yy * inverse
        row[14] = -xy * inverse
        row[15] = xx * inverse
        left = max(0, int(math.ceil(u - rx - HALF)))
        right = min(width - 1, int(math.floor(u + rx - HALF)))
        top = max(0, int(math.ceil(v - ry - HALF)))
        bottom = min(height - 1, int(math.floor(v + ry - HALF)))
        if left <= right and top <= bottom:
            row[10] = rx
            row[11] = ry
            radii[i] = max(rx, ry)
            bound[i] = (right // 16 - left // 16 + 1) * (bottom // 16 - top // 16 + 1)


@inlined
def pull_back(
    camera: Any,
    x: Any,
    y: Any,
    z: Any,
    t: Any,
    r: Any,
    m: Any,
    scales: Any,
    quat: Any,
    conic: Any,
    gu: Any,
    gv: Any,
    ga: Any,
    gb: Any,
    gc: Any,
    gz: Any,
) -> tuple[Any, ...]:
    """Gradients in (mean 3, log-scale 3, quat 4) from those in (u, v, A, B, C, z).

    The chain conic -> covariance (dS = -C G C) -> A = T R S -> its factors; T, u, v -> mean.
    """
    ca, cb, cc = conic
    gh = HALF * gb
    h00, h01 = ca * ga + cb * gh, ca * gh + cb * gc
    h10, h11 = cb * ga + cc * gh, cb * gh + cc * gc
    p00, p01, p11 = -(h00 * ca + h01 * cb), -(h00 * cb + h01 * cc), -(h10 * cb + h11 * cc)
    s0, s1, s2 = scales
    d00, d10 = TWO * (p00 * m[0] + p01 * m[3]) * s0, TWO * (p01 * m[0] + p11 * m[3]) * s0
    d01, d11 = TWO * (p00 * m[1] + p01 * m[4]) * s1, TWO * (p01 * m[1] + p11 * m[4]) * s1
    d02, d12 = TWO * (p00 * m[2] + p01 * m[5]) * s2, TWO * (p01 * m[2] + p11 * m[5]) * s2
    # so far d(loss)/d(A) with A = U S; log-scale gradient = A . dA, dU = dA S
    l0 = s0 * (d00 * m[0] + d10 * m[3])
    l1 = s1 * (d01 * m[1] + d11 * m[4])
    l2 = s2 * (d02 * m[2] + d12 * m[5])
    d00, d10, d01, d11, d02, d12 = d00 * s0, d10 * s0, d01 * s1, d11 * s1, d02 * s2, d12 * s2
    e0, e1, e2 = t[0] * d00 + t[3] * d10, t[0] * d01 + t[3] * d11, t[0] * d02 + t[3] * d12
    e3, e4, e5 = t[1] * d00 + t[4] * d10, t[1] * d01 + t[4] * d11, t[1] * d02 + t[4] * d12
    e6, e7, e8 = t[2] * d00 + t[5] * d10, t[2] * d01 + t[5] * d11, t[2] * d02 + t[5] * d12
    qw, qx, qy, qz, qi = quat
    kw = TWO * (qx * (e7 - e5) + qy * (e2 - e6) + qz * (e3 - e1))
    kx = TWO * (-TWO * qx * (e4 + e8) + qy * (e1 + e3) + qz * (e2 + e6) + qw * (e7 - e5))
    ky = TWO * (qx * (e1 + e3) - TWO * qy * (e0 + e8) + qz * (e5 + e7) + qw * (e2 - e6))
    kz = TWO * (qx * (e2 + e6) + qy * (e5 + e7) - TWO * qz * (e0 + e4) + qw * (e3 - e1))
    along = kw * qw + kx * qx + ky * qy + kz * qz
    t0 = d00 * r[0] + d01 * r[1] + d02 * r[2]
    t1 = d00 * r[3] + d01 * r[4] + d02 * r[5]
    t2 = d00 * r[6] + d01 * r[7] + d02 * r[8]
    t3 = d10 * r[0] + d11 * r[1] + d12 * r[2]
    t4 = d10 * r[3] + d11 * r[4] + d12 * r[5]
    t5 = d10 * r[6] + d11 * r[7] + d12 * r[8]
    # dJ = dT W^T, only its four entries that depend on the mean
    j00 = t0 * camera[0] + t1 * camera[1] + t2 * camera[2]
    j02 = t0 * camera[6] + t1 * camera[7] + t2 * camera[8]
    j11 = t3 * camera[3] + t4 * camera[4] + t5 * camera[5]
    j12 = t3 * camera[6] + t4 * camera[7] + t5 * camera[8]
    inverse = ONE / z
    fx, fy = camera[15] * inverse, camera[16] * inverse
    gx = fx * (gu - j02 * inverse)
    gy = fy * (gv - j12 * inverse)
    gz -= inverse * (fx * (x * gu + j00) + fy * (y * gv + j11))
    gz += TWO * inverse * inverse * (fx * x * j02 + fy * y * j12)
    return (
        camera[0] * gx + camera[3] * gy + camera[6] * gz,
        camera[1] * gx + camera[4] * gy + camera[7] * gz,
        camera[2] * gx + camera[5] * gy + camera[8] * gz,
        l0,
        l1,
        l2,
        (kw - along * qw) * qi,
        (kx - along * qx) * qi,
        (ky - along * qy) * qi,
        (kz - along * qz) * qi,
    )


@kernel
def project_backward(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    shN: Any,
    factors: Any,
    degree: int,
    camera: Any,
    rows: Any,
    clipped: Any,
    first: Any,
    slots: Any,
    g_means: Any,
    g_quats: Any,
    g_log_scales: Any,
    g_logits: Any,
    g_sh0: Any,
    g_shN: Any,
    g_factors: Any,
    g_offset: Any,
) -> None:
    """Sum every Gaussian's slots in their order, then pull the sums back to the parameters.

    Slot lanes: sums over pixels of a = (d loss / d alpha) alpha times 1, dx, dx^2, dy, dx dy, dy^2,
    then of weight times d loss / d (r, g, b, depth); see `tiles.blend_backward`.
    """
    n = len(means)
    basis = np.empty(15, np.float32)
    project_sh = np.empty(15, np.float32)
    total = np.empty(16, np.float32)
    terms = (degree + 1) * (degree + 1) - 1
    for i in range(n * block // blocks, n * (block + 1) // blocks):
        row = rows[i]
        if first[i] == first[i + 1]:
            g_means[i, :] = ZERO
            g_quats[i, :] = ZERO
            g_log_scales[i, :] = ZERO
            g_logits[i] = ZERO
            g_sh0[i, 0, :] = ZERO
            g_shN[i, :, :] = ZERO
            g_factors[i] = ZERO
            g_offset[i, :] = ZERO
            continue
        sums = zeros()
        for j in range(first[i], first[i + 1]):
            sums = sums + load(slots, j * 16)
        store(total, 0, sums)
        ca, cb, cc = row[13], row[14], row[15]
        gu = ca * total[1] + cb * total[3]
        gv = cb * total[1] + cc * total[3]
        ga, gb, gc = -HALF * total[2], -total[4], -HALF * total[5]
        x, y, z = to_camera(camera, means[i])
        t = screen_axes(camera, x, y, z)
        quat = unit_quat(quats[i])
        r = rotation(quat[0], quat[1], quat[2], quat[3])
        m = times_rotation(t, r)
        scales = (
            math.exp(log_scales[i, 0]),
            math.exp(log_scales[i, 1]),
            math.exp(log_scales[i, 2]),
        )
        g = pull_back(
            camera, x, y, z, t, r, m, scales, quat, (ca, cb, cc), gu, gv, ga, gb, gc, total[9]
        )
        gr = ZERO if clipped[i] & 1 else total[6]
        gg = ZERO if clipped[i] & 2 else total[7]
        gl = ZERO if clipped[i] & 4 else total[8]
        mx, my, mz = g[0], g[1], g[2]
        g_sh0[i, 0, 0] = Y0 * gr
        g_sh0[i, 0, 1] = Y0 * gg
        g_sh0[i, 0, 2] = Y0 * gl
        if degree > 0:
            dx, dy, dz, inverse = _direction(camera, means[i])
            _basis(degree, dx, dy, dz, basis)
            for k in range(terms):
                g_shN[i, k, 0] = basis[k] * gr
                g_shN[i, k, 1] = basis[k] * gg
                g_shN[i, k, 2] = basis[k] * gl
                project_sh[k] = gr * shN[i, k, 0] + gg * shN[i, k, 1] + gl * shN[i, k, 2]
            vx, vy, vz = _basis_gradient(degree, dx, dy, dz, project_sh)
            radial = vx * dx + vy * dy + vz * dz
            mx += (vx - radial * dx) * inverse
            my += (vy - radial * dy) * inverse
            mz += (vz - radial * dz) * inverse
        g_shN[i, terms:, :] = ZERO
        g_means[i, 0] = mx
        g_means[i, 1] = my
        g_means[i, 2] = mz
        for k in range(3):
            g_log_scales[i, k] = g[3 + k]
        for k in range(4):
            g_quats[i, k] = g[6 + k]
        opacity = ONE / (ONE + math.exp(-logits[i]))
        g_opacity = total[0] / row[12]
        g_factors[i] = g_opacity * opacity
        g_logits[i] = g_opacity * factors[i] * opacity * (ONE - opacity)
        g_offset[i, 0] = gu
        g_offset[i, 1] = gv
