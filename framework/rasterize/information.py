"""Screen-space second moments -> Fisher information of the stored parameters.

A pixel's colour C_c depends on a Gaussian through its alpha and, for the mean, through its colour:
the SH direction. With d = (u, v, A, B, C, logit) the numbers that alpha depends on,
d(alpha)/d(d) = alpha L m for m = (1, dx, dy, dx^2, dx dy, dy^2), with K = d(d)/d(parameters) and
J_c = alpha dC_c/d(alpha),

    dC_c / d(parameters) = J_c K^T L m + weight v_c,   v_c = d(colour_c) / d(mean)

Summed over pixels and channels its outer products are

    F = K^T L Q L^T K + sum_c (K^T L h_c v_c^T + v_c h_c^T L^T K) + W sum_c v_c v_c^T

with Q = sum q m m^T, h_c = sum weight J_c m, W = sum weight^2 (`tiles.blend_moments`): exact, as
every pixel's outer product is in these sums. The direction is a unit vector, so v_c = sum_k
s_ck e_k with two tangents e_k, and two sums over the channels, h_k = sum_c s_ck h_c, hold all.
Clamped colours have s_ck = 0; at SH degree 0 only the first term is left.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.jit import inlined, kernel
from framework.rasterize.projection import (
    Y0,
    basis_gradient,
    direction,
    rotation,
    to_camera,
    unit_quat,
)
from framework.rasterize.simd import fma, load, splat, store, zeros

f4 = np.float32
ZERO, ONE, TWO = f4(0), f4(1), f4(2)
# which of the 15 sums holds m_i m_j
_PLACE = np.array(
    [
        [0, 1, 2, 3, 4, 5],
        [1, 3, 4, 6, 7, 8],
        [2, 4, 5, 7, 8, 9],
        [3, 6, 7, 10, 11, 12],
        [4, 7, 8, 11, 12, 13],
        [5, 8, 9, 12, 13, 14],
    ],
    dtype=np.int64,
)


@inlined
def _tangents(x: Any, y: Any, z: Any) -> tuple[Any, ...]:
    """Two unit vectors at right angles to the unit (x, y, z) and to each other, six numbers.

    Duff et al. 2017, "Building an orthonormal basis, revisited"."""
    sign = ONE if z >= ZERO else -ONE
    a = -ONE / (sign + z)
    b = x * y * a
    return (ONE + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y)


@kernel
def colour_slopes(
    block: int,
    blocks: int,
    means: Any,
    shN: Any,
    degree: int,
    camera: Any,
    clipped: Any,
    touched: Any,
    slopes: Any,
) -> None:
    """slopes [N, 16] of the Gaussians that touch a tile: 0-5 the derivative of colour c along
    tangent k per scene unit at 2 c + k, 0 where the colour is clamped; 6-11 the two tangents."""
    n = len(means)
    for i in range(n * block // blocks, n * (block + 1) // blocks):
        if touched[i] == 0:
            continue
        x, y, z, inverse = direction(camera, means[i])
        ax, ay, az, bx, by, bz = _tangents(x, y, z)
        row = slopes[i]
        for c in range(3):
            gx, gy, gz = basis_gradient(degree, x, y, z, shN[i, :, c])
            scale = ZERO if (clipped[i] >> c) & 1 else inverse
            row[2 * c] = scale * (gx * ax + gy * ay + gz * az)
            row[2 * c + 1] = scale * (gx * bx + gy * by + gz * bz)
        row[6], row[7], row[8] = ax, ay, az
        row[9], row[10], row[11] = bx, by, bz


@inlined
def _axis(
    k: int,
    camera: Any,
    r: Any,
    log_scale: Any,
    fx: Any,
    gx: Any,
    fy: Any,
    gy: Any,
    ca: Any,
    cb: Any,
    cc: Any,
) -> tuple[Any, ...]:
    """s_k^2, the two numbers of C m_k, and the three of W r_k."""
    p0 = camera[0] * r[k] + camera[1] * r[3 + k] + camera[2] * r[6 + k]
    p1 = camera[3] * r[k] + camera[4] * r[3 + k] + camera[5] * r[6 + k]
    p2 = camera[6] * r[k] + camera[7] * r[3 + k] + camera[8] * r[6 + k]
    mx, my = fx * p0 + gx * p2, fy * p1 + gy * p2
    return math.exp(TWO * log_scale[k]), ca * mx + cb * my, cb * mx + cc * my, p0, p1, p2


@inlined
def _put(jacobian: Any, lane: int, ax: Any, ay: Any, bx: Any, by: Any) -> None:
    """Lane = the product of the linear forms a . (dx, dy) and b . (dx, dy) in m."""
    jacobian[48 + lane] = ax * bx
    jacobian[64 + lane] = ax * by + ay * bx
    jacobian[80 + lane] = ay * by


@inlined
def _screen_jacobian(
    mean: Any, quat: Any, log_scale: Any, camera: Any, row: Any, jacobian: Any
) -> None:
    """jacobian (flat [6, 16]) = L^T K: lanes d(alpha)/d(mean 3, log-scale 3, quat 4) / alpha of
    the coefficients of m; row 0 and the other lanes stay as they are.

    alpha depends on the 2D covariance S' by y^T dS' y / 2, y = C (dx, dy) with the conic C, and
    S' = sum_k s_k^2 m_k m_k^T (+ dilation), m_k = J (W r_k) with the columns r_k of the rotation.
    """
    x, y, z = to_camera(camera, mean)
    qw, qx, qy, qz, inverse_norm = unit_quat(quat)
    r = rotation(qw, qx, qy, qz)
    ca, cb, cc = row[13], row[14], row[15]
    inverse = ONE / z
    fx, fy = camera[15] * inverse, camera[16] * inverse
    gx, gy = -fx * x * inverse, -fy * y * inverse
    # per axis k of the Gaussian: s_k^2, C m_k; b = sum_k (W r_k) s_k^2 (C m_k)^T
    s0, n0x, n0y, p0, p1, p2 = _axis(0, camera, r, log_scale, fx, gx, fy, gy, ca, cb, cc)
    s1, n1x, n1y, p3, p4, p5 = _axis(1, camera, r, log_scale, fx, gx, fy, gy, ca, cb, cc)
    s2, n2x, n2y, p6, p7, p8 = _axis(2, camera, r, log_scale, fx, gx, fy, gy, ca, cb, cc)
    k0x, k0y, k1x, k1y, k2x, k2y = s0 * n0x, s0 * n0y, s1 * n1x, s1 * n1y, s2 * n2x, s2 * n2y
    b0x, b0y = p0 * k0x + p3 * k1x + p6 * k2x, p0 * k0y + p3 * k1y + p6 * k2y
    b1x, b1y = p1 * k0x + p4 * k1x + p7 * k2x, p1 * k0y + p4 * k1y + p7 * k2y
    b2x, b2y = p2 * k0x + p5 * k1x + p8 * k2x, p2 * k0y + p5 * k1y + p8 * k2y
    _put(jacobian, 3, k0x, k0y, n0x, n0y)
    _put(jacobian, 4, k1x, k1y, n1x, n1y)
    _put(jacobian, 5, k2x, k2y, n2x, n2y)
    # a turn by w about the Gaussian's own axis 0 mixes axes 1 and 2, and so on; w = 2 q* dq
    _put(jacobian, 6, (s1 - s2) * n1x, (s1 - s2) * n1y, n2x, n2y)
    _put(jacobian, 7, (s2 - s0) * n2x, (s2 - s0) * n2y, n0x, n0y)
    _put(jacobian, 8, (s0 - s1) * n0x, (s0 - s1) * n0y, n1x, n1y)
    # camera-space mean: through u, v, and through the entries of J
    _put(jacobian, 0, -fx * inverse * ca, -fx * inverse * cb, b2x, b2y)
    _put(jacobian, 1, -fy * inverse * cb, -fy * inverse * cc, b2x, b2y)
    ux, uy = -fx * b0x - TWO * gx * b2x, -fx * b0y - TWO * gx * b2y
    vx, vy = -fy * b1x - TWO * gy * b2x, -fy * b1y - TWO * gy * b2y
    jacobian[50] = inverse * (ca * ux + cb * vx)
    jacobian[66] = inverse * (ca * uy + cb * ux + cb * vy + cc * vx)
    jacobian[82] = inverse * (cb * uy + cc * vy)
    jacobian[16], jacobian[17], jacobian[18] = ca * fx, cb * fy, ca * gx + cb * gy
    jacobian[32], jacobian[33], jacobian[34] = cb * fx, cc * fy, cb * gx + cc * gy
    for a in range(16, 96, 16):
        dx, dy, dz = jacobian[a], jacobian[a + 1], jacobian[a + 2]
        jacobian[a] = camera[0] * dx + camera[3] * dy + camera[6] * dz
        jacobian[a + 1] = camera[1] * dx + camera[4] * dy + camera[7] * dz
        jacobian[a + 2] = camera[2] * dx + camera[5] * dy + camera[8] * dz
    scale = TWO * inverse_norm
    for a in range(48, 96, 16):
        wx, wy, wz = scale * jacobian[a + 6], scale * jacobian[a + 7], scale * jacobian[a + 8]
        jacobian[a + 6] = -qx * wx - qy * wy - qz * wz
        jacobian[a + 7] = qw * wx - qz * wy + qy * wz
        jacobian[a + 8] = qz * wx + qw * wy - qx * wz
        jacobian[a + 9] = -qy * wx + qx * wy + qw * wz


@inlined
def _slot_sums(slots: Any, begin: int, end: int, out: Any, at: int) -> None:
    """out[at : at + 16] = the sum of slots begin ... end - 1, in their order."""
    sums = zeros()
    for j in range(begin, end):
        sums = sums + load(slots, j * 16)
    store(out, at, sums)


@inlined
def _direction_terms(slope: Any, weight: Any, jacobian: Any, cross: Any, terms: Any) -> Any:
    """The part of F that the colour's direction adds: F += sum_k e_k g_k^T + h_k e_k^T.

    terms (flat [6, 16]) = e_1, e_2, h_1, h_2, g_1, g_2 over the parameters' lanes, where
    g_k = h_k + W sum_l (sum_c s_ck s_cl) e_l. Returns its diagonal."""
    total = zeros()
    for k in range(2):
        terms[16 * k], terms[16 * k + 1] = slope[6 + 3 * k], slope[7 + 3 * k]
        terms[16 * k + 2] = slope[8 + 3 * k]
        h = zeros()
        for b in range(5):
            h = fma(splat(cross[5 * k + b]), load(jacobian, 16 * (b + 1)), h)
        store(terms, 32 + 16 * k, h)
    for k in range(2):
        g = load(terms, 32 + 16 * k)
        e = load(terms, 16 * k)
        total = fma(e, g, total)
        for o in range(2):
            both = slope[k] * slope[o] + slope[2 + k] * slope[2 + o] + slope[4 + k] * slope[4 + o]
            g = fma(splat(weight * both), load(terms, 16 * o), g)
        store(terms, 64 + 16 * k, g)
        total = fma(e, g, total)
    return total


@kernel
def pull_back_moments(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    camera: Any,
    rows: Any,
    clipped: Any,
    first: Any,
    slots: Any,
    slopes: Any,
    cross: Any,
    fisher: Any,
    diagonal: Any,
) -> None:
    """Fisher block [N, 6, 6] in (mean, log-scale); diagonal [N, 14] in (mean 3, log-scale 3,
    quat 4, opacity logit, sh0 3). Zeros where the camera sees nothing of the Gaussian.

    slopes, cross: empty where no colour depends on the direction. Lanes are the parameters."""
    n = len(means)
    directional = len(cross) > 0
    moments = np.empty(32, np.float32)
    jacobian, image = np.zeros(96, np.float32), np.empty(96, np.float32)
    terms = np.zeros(96, np.float32)
    line = np.empty(16, np.float32)
    for i in range(n * block // blocks, n * (block + 1) // blocks):
        if first[i] == first[i + 1]:
            fisher[i, :, :] = ZERO
            diagonal[i, :] = ZERO
            continue
        _slot_sums(slots, first[i], first[i + 1], moments, 0)
        _screen_jacobian(means[i], quats[i], log_scales[i], camera, rows[i], jacobian)
        squares = zeros()
        for a in range(1, 6):
            value = zeros()
            for b in range(1, 6):
                value = fma(splat(moments[_PLACE[a, b]]), load(jacobian, 16 * b), value)
            store(image, 16 * a, value)
            squares = fma(load(jacobian, 16 * a), value, squares)
        if directional:
            _slot_sums(cross, first[i], first[i + 1], moments, 16)
            squares = squares + _direction_terms(
                slopes[i], moments[15], jacobian, moments[16:], terms
            )
        store(line, 0, squares)
        for p in range(10):
            diagonal[i, p] = line[p]
        transparency = ONE / (ONE + math.exp(logits[i]))  # d(alpha)/d(logit) / alpha
        diagonal[i, 10] = transparency * transparency * moments[0]
        for channel in range(3):
            seen = ZERO if (clipped[i] >> channel) & 1 else Y0 * Y0 * moments[15]
            diagonal[i, 11 + channel] = seen
        for p in range(6):
            value = zeros()
            for a in range(1, 6):
                value = fma(splat(jacobian[16 * a + p]), load(image, 16 * a), value)
            if directional:
                for k in range(2):
                    value = fma(splat(terms[16 * k + p]), load(terms, 64 + 16 * k), value)
                    value = fma(splat(terms[32 + 16 * k + p]), load(terms, 16 * k), value)
            store(line, 0, value)
            for o in range(p, 6):
                fisher[i, p, o] = line[o]
                fisher[i, o, p] = line[o]
