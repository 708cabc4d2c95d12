"""Screen-space second moments -> Fisher information of the stored parameters.

A pixel's colour C_c depends on a Gaussian through its alpha and, for the mean, through its colour:
the SH direction. With d = (u, v, A, B, C, logit) the numbers that alpha depends on,
d(alpha)/d(d) = alpha L m for m = (1, dx, e, dx^2, dx e, e^2), with K = d(d)/d(parameters) and
J_c = alpha dC_c/d(alpha),

    dC_c / d(parameters) = J_c K^T L m + weight v_c,   v_c = d(colour_c) / d(mean)

Summed over pixels and channels its outer products are

    F = K^T L Q L^T K + sum_c (K^T L h_c v_c^T + v_c h_c^T L^T K) + W sum_c v_c v_c^T

with Q = sum q m m^T, h_c = sum weight J_c m, W = sum weight^2 (`moments.blend_moments`): exact, as
every pixel's outer product is in these sums. The direction is a unit vector, so v_c = sum_k
s_ck e_k with two tangents e_k, and two sums over the channels, h_k = sum_c s_ck h_c, hold all.
Clamped colours have s_ck = 0; at SH degree 0 only the first term is left.
"""

import numpy as np

from framework.compute.chunks import put_row, span, take1, take3, take4, take_row
from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    fma,
    greater_equal,
    load,
    load16,
    select,
    splat,
    store,
    zeros,
)
from framework.kernels.project.ewa import conic_of, exp
from framework.kernels.project.harmonics import Y0, basis_gradient, direction
from framework.kernels.project.jacobian import PARAMETERS, screen_jacobian

f4 = np.float32
ZERO, ONE = f4(0), f4(1)
# which of the 15 sums holds the product of two of (dx, e, dx^2, dx e, e^2)
_PLACE = np.array(
    [
        [3, 4, 6, 7, 8],
        [4, 5, 7, 8, 9],
        [6, 7, 10, 11, 12],
        [7, 8, 11, 12, 13],
        [8, 9, 12, 13, 14],
    ],
    dtype=np.int64,
)


@inlined
def _tangents(x, y, z):
    """Two unit vectors at right angles to the unit (x, y, z) and to each other, six numbers.

    Duff et al. 2017, "Building an orthonormal basis, revisited"."""
    sign = select(greater_equal(z, zeros()), splat(ONE), splat(-ONE))
    a = -ONE / (sign + z)
    b = x * y * a
    return (ONE + sign * x * x * a, sign * b, -sign * x, b, sign + y * y * a, -y)


@kernel
def colour_slopes(block, blocks, means, shN, degree, camera, clipped, slopes):
    """Write into slopes (flat [N, 16]) how the colour changes when the Gaussian moves sideways.

    Entry 2 c + k is the derivative of colour c along tangent k per scene unit, 0 if the colour is
    clamped or has only SH degree 0. Entries 6-11 are the two tangents. Culled Gaussians are
    undefined. means is flat, shN is [M, K, 3].
    """
    n = len(means) // 3
    terms = (degree + 1) * (degree + 1) - 1
    scratch, sh = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    start, end = span(n, block, blocks)
    for base in range(start, end, LANES):
        count = min(LANES, end - base)
        x, y, z, inverse = direction(camera, take3(means, base, count, scratch))
        e = _tangents(x, y, z)
        tail = (*e, zeros(), zeros(), zeros(), zeros())
        r = _along(degree, terms, 0, base, count, shN, clipped, x, y, z, inverse, e, sh, scratch)
        g = _along(degree, terms, 1, base, count, shN, clipped, x, y, z, inverse, e, sh, scratch)
        b = _along(degree, terms, 2, base, count, shN, clipped, x, y, z, inverse, e, sh, scratch)
        put_row(slopes, base, count, sh, (*r, *g, *b, *tail))


@inlined
def _along(degree, terms, channel, base, count, shN, clipped, x, y, z, inverse, e, sh, scratch):
    """Derivatives of one channel's colour along the two tangents e."""
    for lane in range(count):
        for k in range(terms):
            sh[lane * LANES + k] = shN[base + lane, k, channel] if base + lane < len(shN) else ZERO
        scratch[lane] = ZERO if (clipped[base + lane] >> channel) & 1 else ONE
    gx, gy, gz = basis_gradient(degree, x, y, z, load16(sh, 0))
    scale = inverse * load(scratch, 0)
    return (
        scale * (gx * e[0] + gy * e[1] + gz * e[2]),
        scale * (gx * e[3] + gy * e[4] + gz * e[5]),
    )


@inlined
def _sums(first, sums, base, count, rows, columns):
    """columns (flat [16, 16]): the sum of every Gaussian's parts in their order, a lane each."""
    for lane in range(count):
        total = zeros()
        for j in range(first[base + lane], first[base + lane + 1]):
            total = total + load(sums, j * LANES)
        store(rows, lane * LANES, total)
    vectors = load16(rows, 0)
    for k in range(LANES):
        store(columns, k * LANES, vectors[k])


@inlined
def _through_alpha(moments, jacobian, image, fisher, turns):
    """K^T L Q L^T K: fisher (flat [6, 6, 16]) where p <= o; turns (flat [4, 16]): of the quat."""
    for o in range(PARAMETERS):
        for a in range(5):
            value = zeros()
            for b in range(0 if o < 3 else 2, 5):  # only the mean moves u and v
                moment = load(moments, _PLACE[a, b] * LANES)
                value = fma(moment, load(jacobian, (b * PARAMETERS + o) * LANES), value)
            store(image, a * LANES, value)
        for p in range(0 if o < 6 else o, o + 1):
            value = zeros()
            for a in range(0 if p < 3 else 2, 5):
                slope = load(jacobian, (a * PARAMETERS + p) * LANES)
                value = fma(slope, load(image, a * LANES), value)
            if o < 6:
                store(fisher, (p * 6 + o) * LANES, value)
            else:
                store(turns, (o - 6) * LANES, value)


@inlined
def _through_direction(moments, slopes, cross, jacobian, h, fisher):
    """Add sum_k e_k h_k^T + h_k e_k^T + W sum_kl (sum_c s_ck s_cl) e_k e_l^T where p <= o.

    moments, slopes, cross: flat [16, 16], a lane for every Gaussian; h: flat [2, 6, 16], scratch.
    """
    for k in range(2):
        for p in range(6):
            value = zeros()
            for b in range(0 if p < 3 else 2, 5):
                slope = load(jacobian, (b * PARAMETERS + p) * LANES)
                value = fma(load(cross, (5 * k + b) * LANES), slope, value)
            store(h, (6 * k + p) * LANES, value)
    for k in range(2):
        for p in range(3):
            e = load(slopes, (6 + 3 * k + p) * LANES)
            for o in range(p, 6):
                value = fma(e, load(h, (6 * k + o) * LANES), load(fisher, (p * 6 + o) * LANES))
                if o < 3:
                    other = load(slopes, (6 + 3 * k + o) * LANES)
                    value = fma(other, load(h, (6 * k + p) * LANES), value)
                store(fisher, (p * 6 + o) * LANES, value)
        for q in range(2):
            both = zeros()
            for c in range(3):
                item = load(slopes, (2 * c + k) * LANES)
                both = fma(item, load(slopes, (2 * c + q) * LANES), both)
            both = both * load(moments, 15 * LANES)
            for p in range(3):
                e = both * load(slopes, (6 + 3 * k + p) * LANES)
                for o in range(p, 3):
                    value = load(fisher, (p * 6 + o) * LANES)
                    other = load(slopes, (6 + 3 * q + o) * LANES)
                    store(fisher, (p * 6 + o) * LANES, fma(e, other, value))


@kernel
def _write(base, count, first, clipped, moments, values, turns, transparency, fisher, diagonal):
    """The lanes to the Gaussians' places; zeros for those that are not seen."""
    for lane in range(count):
        i = base + lane
        fisher[i, :, :] = ZERO
        diagonal[i, :] = ZERO
        if first[i] == first[i + 1]:
            continue
        for p in range(6):
            for o in range(p, 6):
                value = values[(p * 6 + o) * LANES + lane]
                if p == o:
                    value = max(value, ZERO)  # a sum of squares, but for rounding
                fisher[i, p, o] = value
                fisher[i, o, p] = value
            diagonal[i, p] = fisher[i, p, p]
        for p in range(4):
            diagonal[i, 6 + p] = max(turns[p * LANES + lane], ZERO)
        rate = transparency[lane]
        diagonal[i, 10] = rate * rate * moments[lane]
        for c in range(3):
            if (clipped[i] >> c) & 1 == 0:
                diagonal[i, 11 + c] = Y0 * Y0 * moments[15 * LANES + lane]


@kernel
def pull_back_moments(
    block,
    blocks,
    means,
    quats,
    log_scales,
    logits,
    camera,
    rows,
    clipped,
    first,
    sums,
    slopes,
    cross,
    fisher,
    diagonal,
):
    """Fisher block [N, 6, 6] in (mean, log-scale); diagonal [N, 14] in (mean 3, log-scale 3,
    quat 4, opacity logit, sh0 3). Zeros where the camera sees nothing of the Gaussian.

    Args:
        slopes, cross: empty where no colour depends on the direction. All inputs are flat.
    """
    n = len(logits)
    scratch, square = np.empty(4 * LANES, np.float32), np.zeros(256, np.float32)
    moments, slope = np.empty(256, np.float32), np.empty(256, np.float32)
    mixed = np.empty(256, np.float32)
    jacobian = np.empty(5 * PARAMETERS * LANES, np.float32)
    image, h = np.empty(5 * LANES, np.float32), np.empty(12 * LANES, np.float32)
    values, turns = np.empty(36 * LANES, np.float32), np.empty(4 * LANES, np.float32)
    transparency = np.empty(LANES, np.float32)
    start, end = span(n, block, blocks)
    for base in range(start, end, LANES):
        count = min(LANES, end - base)
        if first[base] == first[base + count]:
            fisher[base : base + count] = ZERO
            diagonal[base : base + count] = ZERO
            continue
        _sums(first, sums, base, count, square, moments)
        row = take_row(rows, base, count, square)
        screen_jacobian(
            camera,
            take3(means, base, count, scratch),
            take4(quats, base, count, scratch),
            take3(log_scales, base, count, scratch),
            conic_of(row),
            jacobian,
        )
        _through_alpha(moments, jacobian, image, values, turns)
        if len(cross) > 0:
            _sums(first, cross, base, count, square, mixed)
            columns = take_row(slopes, base, count, square)
            for k in range(LANES):
                store(slope, k * LANES, columns[k])
            _through_direction(moments, slope, mixed, jacobian, h, values)
        # d(alpha)/d(logit) / alpha
        store(transparency, 0, ONE / (ONE + exp(take1(logits, base, count, scratch))))
        _write(base, count, first, clipped, moments, values, turns, transparency, fisher, diagonal)
