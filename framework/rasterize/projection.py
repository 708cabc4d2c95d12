"""Gaussians -> screen, and the gradient back: kernels over blocks of Gaussians, 16 at a time.

A projected Gaussian is one row of 16 floats (a cache line): 0-1 mean u, v [px]; 2-4 -A/2, -B, -C/2
times log2(e); 5 log2(opacity); 6-8 colour; 9 depth; 10-11 half-sides of the box that holds all
alpha >= 1/255 [px], -1 if culled; 12 opacity; 13-15 conic A, B, C (inverse 2D covariance).
With it the blending kernels get alpha = 2^(row[5] + row[2] dx^2 + row[3] dx dy + row[4] dy^2).

Camera row (float32[20]): rotation (9), translation (3), centre (3), fx, fy, cx, cy, near.
EWA splatting (Zwicker et al. 2001) as in 3DGS, spherical harmonics with its signs. The helpers are
for float32 numbers and for vectors of them (`simd`) alike.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.jit import inlined, kernel
from framework.rasterize.chunks import put1, put2, put3, put4, take1, take2, take3, take4
from framework.rasterize.constants import ALPHA_MIN, DILATION, FRUSTUM_MARGIN
from framework.rasterize.simd import (
    LANES,
    absolute,
    any_lane,
    both,
    ceil,
    exp2,
    floor,
    greater,
    greater_equal,
    load,
    load16,
    log2,
    maximum,
    minimum,
    select,
    splat,
    store,
    store16,
    store_whole,
    zeros,
)

f4 = np.float32

_LOG2E = f4(1.4426950408889634)
_CUT = f4(ALPHA_MIN)
_DILATION = f4(DILATION)
_REACH = f4(0.5 + FRUSTUM_MARGIN)
_HUGE = f4(1e30)
_LARGEST = f4(126)
_TWO_LN2, _LOG2_255 = f4(2 * math.log(2)), f4(math.log2(255))
_TILE = f4(1 / 16)

# normalisation of the real spherical harmonics up to degree 3
Y0 = f4(0.28209479177387814)
_Y1 = f4(0.4886025119029199)
_Y2A, _Y2B, _Y2C = f4(1.0925484305920792), f4(0.31539156525252005), f4(0.5462742152960396)
_Y3A, _Y3B, _Y3C = f4(0.5900435899266435), f4(2.890611442640554), f4(0.4570457994644658)
_Y3D, _Y3E = f4(0.3731763325901154), f4(1.445305721320277)
ONE, TWO, THREE, FOUR, SIX, EIGHT = f4(1), f4(2), f4(3), f4(4), f4(6), f4(8)
ZERO, HALF = f4(0), f4(0.5)


@inlined
def basis(x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """The 15 basis functions of the degrees 1 to 3 at a unit direction."""
    xx, yy, zz = x * x, y * y, z * z
    return (
        -_Y1 * y,
        _Y1 * z,
        -_Y1 * x,
        _Y2A * x * y,
        -_Y2A * y * z,
        _Y2B * (TWO * zz - xx - yy),
        -_Y2A * x * z,
        _Y2C * (xx - yy),
        -_Y3A * y * (THREE * xx - yy),
        _Y3B * x * y * z,
        -_Y3C * y * (FOUR * zz - xx - yy),
        _Y3D * z * (TWO * zz - THREE * xx - THREE * yy),
        -_Y3C * x * (FOUR * zz - xx - yy),
        _Y3E * z * (xx - yy),
        -_Y3A * x * (xx - THREE * yy),
    )


@inlined
def basis_gradient(degree: int, x: Any, y: Any, z: Any, d: Any) -> tuple[Any, Any, Any]:
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
def direction(camera: Any, mean: Any) -> tuple[Any, Any, Any, Any]:
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


@inlined
def exp(x: Any) -> Any:
    """Of a vector; 2^126 where that is exceeded or x is not a number."""
    return exp2(minimum(x * _LOG2E, splat(_LARGEST)))


@inlined
def _sh_color(degree: int, way: Any, base: int, count: int, shN: Any, sh: Any) -> Any:
    """What the bands above 0 add to red, green, blue; sh [256] is scratch."""
    b = basis(way[0], way[1], way[2])
    store16(sh, 0, (*b, zeros()))
    for lane in range(count):
        red, green, blue = ZERO, ZERO, ZERO
        for k in range((degree + 1) * (degree + 1) - 1):
            value = sh[lane * LANES + k]
            red += value * shN[base + lane, k, 0]
            green += value * shN[base + lane, k, 1]
            blue += value * shN[base + lane, k, 2]
        sh[lane * LANES] = red
        sh[lane * LANES + 1] = green
        sh[lane * LANES + 2] = blue
    sums = load16(sh, 0)
    return sums[0], sums[1], sums[2]


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
    """Fill `rows` (flat [N 16]); clipped [N] uint8: bit c set where colour c was clamped at 0;
    bound [N] int32: the number of tiles the box covers (0 = culled), an upper bound on those
    touched; radii [N]: the larger half-side of the box, 0 if culled. All but shN [N, K, 3] flat."""
    n = len(logits)
    scratch, sh = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    w, h = f4(width), f4(height)
    whole, flags = np.empty(LANES, np.int32), np.empty(LANES, np.uint8)
    for base in range(n * block // blocks, n * (block + 1) // blocks, LANES):
        count = min(LANES, n * (block + 1) // blocks - base)
        mean = take3(means, base, count, scratch)
        x, y, z = to_camera(camera, mean)
        logit = take1(logits, base, count, scratch)
        opacity = take1(factors, base, count, scratch) / (ONE + exp(-logit))
        visible = both(greater_equal(z, splat(camera[19])), greater_equal(opacity, splat(_CUT)))
        inverse_z = ONE / z
        u = camera[15] * x * inverse_z + camera[17]
        v = camera[16] * y * inverse_z + camera[18]
        visible = both(visible, greater_equal(splat(_REACH * w), absolute(u - HALF * w)))
        visible = both(visible, greater_equal(splat(_REACH * h), absolute(v - HALF * h)))
        if not any_lane(visible):
            for i in range(base, base + count):
                bound[i] = 0
                radii[i] = ZERO
            continue
        shift = take2(offset, base, count, scratch)
        u, v = u + shift[0], v + shift[1]
        t = screen_axes(camera, x, y, z)
        quat = take4(quats, base, count, scratch)
        qw, qx, qy, qz, _ = unit_quat(quat)
        m = times_rotation(t, rotation(qw, qx, qy, qz))
        log_scale = take3(log_scales, base, count, scratch)
        s0, s1, s2 = exp(log_scale[0]), exp(log_scale[1]), exp(log_scale[2])
        a0, a1, a2 = m[0] * s0, m[1] * s1, m[2] * s2
        b0, b1, b2 = m[3] * s0, m[4] * s1, m[5] * s2
        xx = a0 * a0 + a1 * a1 + a2 * a2
        xy = a0 * b0 + a1 * b1 + a2 * b2
        yy = b0 * b0 + b1 * b1 + b2 * b2
        # xx yy - xy^2 would cancel for long, thin Gaussians and leave an indefinite conic
        c01, c02, c12 = a0 * b1 - a1 * b0, a0 * b2 - a2 * b0, a1 * b2 - a2 * b1
        determinant = c01 * c01 + c02 * c02 + c12 * c12 + _DILATION * (xx + yy + _DILATION)
        # false also where parameters are not finite
        visible = both(visible, greater(determinant, zeros()))
        visible = both(visible, greater(splat(_HUGE), determinant))
        xx, yy = xx + _DILATION, yy + _DILATION
        inverse = ONE / determinant
        base_color = take3(sh0, base, count, scratch)
        red, green, blue = (
            HALF + Y0 * base_color[0],
            HALF + Y0 * base_color[1],
            HALF + Y0 * base_color[2],
        )
        if degree > 0:
            way = direction(camera, mean)
            more = _sh_color(degree, way, base, count, shN, sh)
            red, green, blue = red + more[0], green + more[1], blue + more[2]
        flag = select(greater(zeros(), red), splat(ONE), zeros())
        flag = flag + select(greater(zeros(), green), splat(TWO), zeros())
        flag = flag + select(greater(zeros(), blue), splat(FOUR), zeros())
        level = log2(opacity)
        reach = _TWO_LN2 * (level + _LOG2_255)
        rx, ry = math.sqrt(reach * xx), math.sqrt(reach * yy)
        left = maximum(ceil(u - rx - HALF), zeros())
        right = minimum(floor(u + rx - HALF), splat(w - ONE))
        top = maximum(ceil(v - ry - HALF), zeros())
        bottom = minimum(floor(v + ry - HALF), splat(h - ONE))
        visible = both(visible, both(greater_equal(right, left), greater_equal(bottom, top)))
        columns = floor(right * _TILE) - floor(left * _TILE) + ONE
        bands = floor(bottom * _TILE) - floor(top * _TILE) + ONE
        put1(radii, base, count, scratch, select(visible, maximum(rx, ry), zeros()))
        row = (
            u,
            v,
            -HALF * _LOG2E * yy * inverse,
            _LOG2E * xy * inverse,
            -HALF * _LOG2E * xx * inverse,
            level,
            maximum(red, zeros()),
            maximum(green, zeros()),
            maximum(blue, zeros()),
            z,
            rx,
            ry,
            opacity,
            yy * inverse,
            -xy * inverse,
            xx * inverse,
        )
        if count == LANES:
            store16(rows, base * LANES, row)
        else:
            store16(sh, 0, row)
            for i in range(count * LANES):
                rows[base * LANES + i] = sh[i]
        store_whole(whole, 0, select(visible, columns * bands, zeros()))
        store_whole(flags, 0, flag)
        for lane in range(count):
            bound[base + lane] = whole[lane]
            clipped[base + lane] = flags[lane]


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


@inlined
def _sum_slots(first: Any, slots: Any, base: int, count: int, total: Any) -> int:
    """The sums of every Gaussian's slots, in their order, into total (flat [16 16]), row 15 of
    which counts them; returns the number of slots."""
    for lane in range(count):
        begin, end = first[base + lane], first[base + lane + 1]
        sums = zeros()
        for j in range(begin, end):
            sums = sums + load(slots, j * LANES)
        store(total, lane * LANES, sums)
        total[lane * LANES + 15] = f4(end - begin)
    return first[base + count] - first[base]


@inlined
def _sh_backward(
    degree: int, base: int, count: int, color: Any, way: Any, shN: Any, g_shN: Any, sh: Any
) -> Any:
    """Fill g_shN; returns the gradient in the unit direction. sh [2, 256] is scratch."""
    terms = (degree + 1) * (degree + 1) - 1
    values, pulls = sh[0], sh[1]
    b = basis(way[0], way[1], way[2])
    store16(values, 0, (*b, zeros()))
    store16(
        pulls,
        0,
        (
            color[0],
            color[1],
            color[2],
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
            zeros(),
        ),
    )
    for lane in range(count):
        at = lane * LANES
        red, green, blue = pulls[at], pulls[at + 1], pulls[at + 2]
        own, out = shN[base + lane], g_shN[base + lane]
        for k in range(terms):
            value = values[at + k]
            out[k, 0] = value * red
            out[k, 1] = value * green
            out[k, 2] = value * blue
            pulls[at + k] = red * own[k, 0] + green * own[k, 1] + blue * own[k, 2]
    return basis_gradient(degree, way[0], way[1], way[2], load16(pulls, 0))


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
    then of weight times d loss / d (r, g, b, depth); see `tiles.blend_backward`. All but shN and
    g_shN [N, K, 3] are flat.
    """
    n = len(logits)
    scratch, total = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    sh, flags = np.zeros((2, 256), np.float32), np.zeros((3, LANES), np.float32)
    terms = (degree + 1) * (degree + 1) - 1
    for base in range(n * block // blocks, n * (block + 1) // blocks, LANES):
        count = min(LANES, n * (block + 1) // blocks - base)
        if _sum_slots(first, slots, base, count, total) == 0:
            g_means[3 * base : 3 * (base + count)] = ZERO
            g_quats[4 * base : 4 * (base + count)] = ZERO
            g_log_scales[3 * base : 3 * (base + count)] = ZERO
            g_logits[base : base + count] = ZERO
            g_sh0[3 * base : 3 * (base + count)] = ZERO
            g_shN[base : base + count] = ZERO
            g_factors[base : base + count] = ZERO
            g_offset[2 * base : 2 * (base + count)] = ZERO
            continue
        s = load16(total, 0)
        if count == LANES:
            row = load16(rows, base * LANES)
        else:
            for i in range(count * LANES):
                total[i] = rows[base * LANES + i]
            row = load16(total, 0)
        seen = greater(s[15], zeros())
        ca, cb, cc = row[13], row[14], row[15]
        gu = select(seen, ca * s[1] + cb * s[3], zeros())
        gv = select(seen, cb * s[1] + cc * s[3], zeros())
        ga, gb, gc = -HALF * s[2], -s[4], -HALF * s[5]
        mean = take3(means, base, count, scratch)
        x, y, z = to_camera(camera, mean)
        t = screen_axes(camera, x, y, z)
        quat = unit_quat(take4(quats, base, count, scratch))
        r = rotation(quat[0], quat[1], quat[2], quat[3])
        m = times_rotation(t, r)
        log_scale = take3(log_scales, base, count, scratch)
        scales = (exp(log_scale[0]), exp(log_scale[1]), exp(log_scale[2]))
        g = pull_back(
            camera, x, y, z, t, r, m, scales, quat, (ca, cb, cc), gu, gv, ga, gb, gc, s[9]
        )
        for lane in range(count):
            for c in range(3):
                flags[c, lane] = f4((clipped[base + lane] >> c) & 1)
        gr = select(both(seen, greater(splat(HALF), load(flags[0], 0))), s[6], zeros())
        gg = select(both(seen, greater(splat(HALF), load(flags[1], 0))), s[7], zeros())
        gl = select(both(seen, greater(splat(HALF), load(flags[2], 0))), s[8], zeros())
        mx, my, mz = g[0], g[1], g[2]
        put3(g_sh0, base, count, scratch, (Y0 * gr, Y0 * gg, Y0 * gl))
        if degree > 0:
            way = direction(camera, mean)
            vx, vy, vz = _sh_backward(degree, base, count, (gr, gg, gl), way, shN, g_shN, sh)
            radial = vx * way[0] + vy * way[1] + vz * way[2]
            mx = mx + (vx - radial * way[0]) * way[3]
            my = my + (vy - radial * way[1]) * way[3]
            mz = mz + (vz - radial * way[2]) * way[3]
        g_shN[base : base + count, terms:, :] = ZERO
        o = zeros()
        put3(
            g_means,
            base,
            count,
            scratch,
            (select(seen, mx, o), select(seen, my, o), select(seen, mz, o)),
        )
        put3(
            g_log_scales,
            base,
            count,
            scratch,
            (select(seen, g[3], o), select(seen, g[4], o), select(seen, g[5], o)),
        )
        put4(
            g_quats,
            base,
            count,
            scratch,
            (
                select(seen, g[6], o),
                select(seen, g[7], o),
                select(seen, g[8], o),
                select(seen, g[9], o),
            ),
        )
        opacity = ONE / (ONE + exp(-take1(logits, base, count, scratch)))
        g_opacity = select(seen, s[0] / row[12], o)
        factor = take1(factors, base, count, scratch)
        put1(g_factors, base, count, scratch, g_opacity * opacity)
        put1(g_logits, base, count, scratch, g_opacity * factor * opacity * (ONE - opacity))
        put2(g_offset, base, count, scratch, (gu, gv))
