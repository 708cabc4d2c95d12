"""Matching cost of a plane sweep: one minus ZNCC, kernel.

Costs are int16 in units of 1/`COST_ONE` (0 = perfect, `COST_ONE` = uncorrelated or worse). Integer
minima vectorise under strict IEEE rules, and a cost volume takes half the memory of float32. Its
layout is [H, D, W]: matching and vertical aggregation run along x, the innermost axis.

For every pixel x of the reference and every plane of inverse depth q, each source is sampled at
A x + q t (`framework.depth.transfer`), bilinearly. ZNCC compares (2 r + 1)^2 windows of that warp
and the reference; windows that leave the image repeat its border. `VARIANCE_FLOOR` keeps windows
without texture (a deviation of about one grey level of 255) from matching their noise.
"""

import math

import numpy as np

from framework.compute.jit import kernel

COST_ONE = 4000  # four paths of (cost + penalty) <= 2 units each stay below the int16 limit
VARIANCE_FLOOR = 2e-5

_F = np.float32
_I = np.int16
_ONE = np.float32(COST_ONE)
_WORST = np.int16(COST_ONE)
_FLOOR = np.float32(VARIANCE_FLOOR)


@kernel
def _locate_row(shape, A, t, q, y, index, du, dv, valid):
    """Locate row y of the reference in one source.

    index: flat index of the upper left of four pixels; du, dv: position between them, clamped to
    the image; valid: 1 inside the image.
    """
    offset, height, width = np.int32(shape[0]), np.int32(shape[1]), np.int32(shape[2])
    right, bottom = _F(width - 1), _F(height - 1)
    last_i, last_j = np.int32(width - 2), np.int32(height - 2)
    Y = _F(y) + _F(0.5)
    u0 = A[0, 1] * Y + A[0, 2] + q * t[0]
    v0 = A[1, 1] * Y + A[1, 2] + q * t[1]
    z0 = A[2, 1] * Y + A[2, 2] + q * t[2]
    a, b, c = A[0, 0], A[1, 0], A[2, 0]
    for x in range(valid.shape[0]):
        X = _F(np.int32(x)) + _F(0.5)
        z = c * X + z0
        w = _F(1.0) / z
        u = (a * X + u0) * w - _F(0.5)
        v = (b * X + v0) * w - _F(0.5)
        inner_u = u if u > _F(0.0) else _F(0.0)
        inner_v = v if v > _F(0.0) else _F(0.0)
        inner_u = inner_u if inner_u < right else right
        inner_v = inner_v if inner_v < bottom else bottom
        moved = abs(inner_u - u) + abs(inner_v - v)
        valid[x] = _F(1.0) if (z > _F(0.0)) & (moved == _F(0.0)) else _F(0.0)
        i, j = np.int32(inner_u), np.int32(inner_v)
        i = i if i < last_i else last_i
        j = j if j < last_j else last_j
        du[x] = inner_u - _F(i)
        dv[x] = inner_v - _F(j)
        index[x] = np.int32(offset + np.int32(j * width) + i)


@kernel
def _sample_row(pixels, width, index, du, dv, warped, radius):
    """Bilinear samples at those places; `warped` repeats its ends `radius` times on both sides."""
    n = index.shape[0]
    out = warped[radius : radius + n]
    one, down = np.uint64(1), np.uint64(width)
    for x in range(n):
        k = np.uint64(np.uint32(index[x]))  # unsigned: no wrap-around test per pixel
        m = k + down
        top = pixels[k] + du[x] * (pixels[k + one] - pixels[k])
        low = pixels[m] + du[x] * (pixels[m + one] - pixels[m])
        out[x] = top + dv[x] * (low - top)
    for x in range(radius):
        warped[x] = out[0]
        warped[n + radius + x] = out[n - 1]


@kernel
def _multiply_rows(warped, reference, squares, products):
    for x in range(warped.shape[0]):
        squares[x] = warped[x] * warped[x]
        products[x] = warped[x] * reference[x]


@kernel
def _copy_row(source, target):
    for x in range(target.shape[0]):
        target[x] = source[x]


@kernel
def _window_sum(values, out, taps):
    """out[x] = sum of the odd number `taps` >= 3 of values from x on; pairs of taps per pass."""
    n = out.shape[0]
    a, b, c = values[:n], values[1 : n + 1], values[2 : n + 2]
    for x in range(n):
        out[x] = a[x] + b[x] + c[x]
    for k in range(3, taps, 2):
        d, e = values[k : n + k], values[k + 1 : n + k + 1]
        for x in range(n):
            out[x] += d[x] + e[x]


@kernel
def _ring_sum(ring, out):
    """out [N] = sum over the odd number >= 3 of rows of ring [taps, N]."""
    a, b, c = ring[0], ring[1], ring[2]
    for x in range(out.shape[0]):
        out[x] = a[x] + b[x] + c[x]
    for k in range(3, ring.shape[0], 2):
        d, e = ring[k], ring[k + 1]
        for x in range(out.shape[0]):
            out[x] += d[x] + e[x]


@kernel
def _score_row(sums, valid, mean, inverse_deviation, scale, out):
    """Costs of one row from its full window sums [3 W]; `scale` = 1 / window size."""
    n = out.shape[0]
    first, second, cross = sums[:n], sums[n : 2 * n], sums[2 * n :]
    for x in range(n):
        m = first[x] * scale
        variance = second[x] * scale - m * m
        variance = (variance if variance > _F(0.0) else _F(0.0)) + _FLOOR
        covariance = cross[x] * scale - m * mean[x]
        cost = _F(1.0) - covariance * inverse_deviation[x] / math.sqrt(variance)
        cost = cost if cost > _F(0.0) else _F(0.0)
        cost = cost if cost < _F(1.0) else _F(1.0)
        cost = cost if valid[x] > _F(0.0) else _F(1.0)
        out[x] = _I(np.int32(cost * _ONE + _F(0.5)))


@kernel
def _keep_best(row, best, y):
    """Insert a row of costs into the ascending layers best[:, y]; `row` is used up."""
    for layer in range(best.shape[0]):
        kept = best[layer, y]
        for x in range(row.shape[0]):
            low = row[x] if row[x] < kept[x] else kept[x]
            high = row[x] if row[x] > kept[x] else kept[x]
            kept[x] = low
            row[x] = high


@kernel
def _match_plane(padded, mean, inverse_deviation, pixels, shape, A, t, q, radius, best):
    """One source at one plane: warp, window sums over a ring of rows, score, keep the best."""
    height, width = mean.shape
    taps = 2 * radius + 1
    scale = _F(1.0) / _F(taps * taps)
    ring = np.empty((taps, 3 * width), np.float32)
    seen = np.empty((taps, width), np.float32)
    index = np.empty(width, np.int32)
    fractions = np.empty((2, width), np.float32)
    warped = np.empty((3, width + 2 * radius), np.float32)
    sums = np.empty(3 * width, np.float32)
    row = np.empty(width, np.int16)
    for y in range(-radius, height + radius):
        slot = (y + taps) % taps
        if -radius < y <= 0 or y >= height:  # repeats the border row, already in the ring
            _copy_row(ring[(y - 1 + taps) % taps], ring[slot])
        else:
            inner = max(y, 0)
            _locate_row(shape, A, t, q, inner, index, fractions[0], fractions[1], seen[slot])
            _sample_row(pixels, shape[2], index, fractions[0], fractions[1], warped[0], radius)
            _multiply_rows(warped[0], padded[inner], warped[1], warped[2])
            for k in range(3):
                _window_sum(warped[k], ring[slot, k * width : (k + 1) * width], taps)
        if y == 0:
            _copy_row(seen[taps - radius], seen[0])
        centre = y - radius
        if centre >= 0:
            _ring_sum(ring, sums)
            valid = seen[centre % taps]
            _score_row(sums, valid, mean[centre], inverse_deviation[centre], scale, row)
            _keep_best(row, best, centre)


@kernel
def match_costs(
    block,
    n_blocks,
    padded,
    mean,
    inverse_deviation,
    pixels,
    shapes,
    A,
    t,
    inverse_depths,
    radius,
    n_best,
    cost,
):
    """Kernel over planes: cost[y, d, x] = mean of the `n_best` lowest costs among the sources.

    Args:
        padded: [H, W + 2 r], reference, its border repeated sideways.
        mean, inverse_deviation [H, W]: of its windows.
        pixels: [P], all sources, flat.
        shapes: [S, 3], (offset, height, width) of each.
        A [S, 3, 3], t [S, 3]: reference to source. inverse_depths [D]. cost [H, D, W] int16.
    """
    height, width = mean.shape
    planes = inverse_depths.shape[0]
    best = np.empty((n_best, height, width), np.int16)
    for d in range(block * planes // n_blocks, (block + 1) * planes // n_blocks):
        for layer in range(n_best):
            for y in range(height):
                for x in range(width):
                    best[layer, y, x] = _WORST
        for s in range(shapes.shape[0]):
            _match_plane(
                padded, mean, inverse_deviation, pixels, shapes[s], A[s], t[s],
                inverse_depths[d], radius, best,
            )  # fmt: skip
        for y in range(height):
            for x in range(width):
                total = np.int32(0)
                for layer in range(n_best):
                    total += np.int32(best[layer, y, x])
                cost[y, d, x] = _I(total // np.int32(n_best))
