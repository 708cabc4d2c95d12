"""Screen-space second moments -> Fisher information of the stored parameters.

A pixel's colour C_c depends on a Gaussian through its alpha and, for the mean, through its colour:
the SH direction. With d = (u, v, A, B, C, logit) the numbers that alpha depends on, d(alpha)/d(d) =
alpha L m for m = (1, dx, dy, dx^2, dx dy, dy^2), K = d(d)/d(parameters) and J_c = alpha dC_c/d(alpha)

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
    pull_back,
    rotation,
    screen_axes,
    times_rotation,
    to_camera,
    unit_quat,
)
from framework.rasterize.simd import fma, load, splat, store, zeros

f4 = np.float32
ZERO, ONE, TWO, HALF = f4(0), f4(1), f4(2), f4(0.5)
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
def _screen_jacobian(
    mean: Any, quat: Any, log_scale: Any, logit: Any, camera: Any, row: Any, jacobian: Any
) -> None:
    """jacobian (flat [6, 16]) = L^T K: lanes d(alpha)/d(mean 3, log-scale 3, quat 4, logit) / alpha
    of the coefficients of m; the other lanes stay as they are."""
    x, y, z = to_camera(camera, mean)
    t = screen_axes(camera, x, y, z)
    q = unit_quat(quat)
    r = rotation(q[0], q[1], q[2], q[3])
    m = times_rotation(t, r)
    s = (math.exp(log_scale[0]), math.exp(log_scale[1]), math.exp(log_scale[2]))
    ca, cb, cc = row[13], row[14], row[15]
    jacobian[10] = ONE / (ONE + math.exp(logit))
    for p in range(3):  # u and v move with the mean alone, by T
        jacobian[16 + p] = ca * t[p] + cb * t[3 + p]
        jacobian[32 + p] = cb * t[p] + cc * t[3 + p]
    for k in range(3):
        ga, gb, gc = ZERO, ZERO, ZERO
        if k == 0:
            ga = -HALF
        elif k == 1:
            gb = -ONE
        else:
            gc = -HALF
        g = pull_back(camera, x, y, z, t, r, m, s, q, (ca, cb, cc), ZERO, ZERO, ga, gb, gc, ZERO)
        at = 48 + 16 * k
        jacobian[at], jacobian[at + 1], jacobian[at + 2] = g[0], g[1], g[2]
        jacobian[at + 3], jacobian[at + 4], jacobian[at + 5] = g[3], g[4], g[5]
        jacobian[at + 6], jacobian[at + 7], jacobian[at + 8] = g[6], g[7], g[8]
        jacobian[at + 9] = g[9]


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
        _screen_jacobian(means[i], quats[i], log_scales[i], logits[i], camera, rows[i], jacobian)
        squares = zeros()
        for a in range(6):
            value = zeros()
            for b in range(6):
                value = fma(splat(moments[_PLACE[a, b]]), load(jacobian, 16 * b), value)
            store(image, 16 * a, value)
            squares = fma(load(jacobian, 16 * a), value, squares)
        if directional:
            _slot_sums(cross, first[i], first[i + 1], moments, 16)
            squares = squares + _direction_terms(
                slopes[i], moments[15], jacobian, moments[16:], terms
            )
        store(line, 0, squares)
        for p in range(11):
            diagonal[i, p] = line[p]
        for channel in range(3):
            seen = ZERO if (clipped[i] >> channel) & 1 else Y0 * Y0 * moments[15]
            diagonal[i, 11 + channel] = seen
        for p in range(6):
            value = zeros()
            for a in range(6):
                value = fma(splat(jacobian[16 * a + p]), load(image, 16 * a), value)
            if directional:
                for k in range(2):
                    value = fma(splat(terms[16 * k + p]), load(terms, 64 + 16 * k), value)
                    value = fma(splat(terms[32 + 16 * k + p]), load(terms, 16 * k), value)
            store(line, 0, value)
            for o in range(p, 6):
                fisher[i, p, o] = line[o]
                fisher[i, o, p] = line[o]
