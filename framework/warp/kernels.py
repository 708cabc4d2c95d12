"""numba kernels of the soft z-buffer warp (`framework.warp.zbuffer`), one support view per call.

Pixel coordinates have the centre of pixel (0, 0) at (0.5, 0.5). `depth` arrays of projected points
are target-camera z, positive for points that paint and occlude, negative (same magnitude) for
points that only occlude. A projected row coordinate of `OUTSIDE` marks a pixel without a point.

`project` divides the source rows among its blocks; all others divide the target rows into bands.
Every target pixel gets its points in source order, so threads cannot change a bit. Each band has
accumulators `z_min` [blocks, cells] and `sums` [blocks, 5 cells], float32, flat over
(band rows + 2) x (W + 2) cells. The border of one pixel saves bounds checks of the four taps of a
point; its values are ignored.
"""

import numpy as np

from framework.compute.jit import inlined, kernel

OUTSIDE = np.float32(-1e30)
MIN_RATIO = 1e-3  # least target z / source z: nearer points magnify a pixel a thousandfold
ZERO, HALF, ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
MIN_TAP = np.float32(1.0 / 16.0)  # least bilinear weight with which a point may hide others
CUTOFF = np.float32(6.0)  # exp(-6) = 0.0025: points further behind the nearest one are hidden


@kernel
def project(block, n_blocks, inverse_depth, paints, matrix, u, v, depth, bounds):
    """Target coordinates of every source pixel: (x, y, w) = matrix (col, row, 1, 1/z), z' = w z.

    Args:
        inverse_depth: [h, w] float32, 0 = none.
        paints: [h, w] bool.
        matrix: [3, 4] float64. Writes u, v (pixels) and depth [h, w] float32, and the range of v
            per source row, bounds [h, 2].
    """
    h, w = inverse_depth.shape
    for row in range(h * block // n_blocks, h * (block + 1) // n_blocks):
        y = row + 0.5
        for col in range(w):
            x = col + 0.5
            inverse = np.float64(inverse_depth[row, col])
            px = matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] + matrix[0, 3] * inverse
            py = matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] + matrix[1, 3] * inverse
            pw = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] + matrix[2, 3] * inverse
            seen = inverse > 0.0 and pw > MIN_RATIO
            z = np.float32(pw / inverse)
            u[row, col] = np.float32(px / pw)
            v[row, col] = np.float32(py / pw) if seen else OUTSIDE
            depth[row, col] = z if paints[row, col] else -z
        low, high = np.float32(np.inf), OUTSIDE
        for col in range(w):
            value = v[row, col]
            if value > OUTSIDE:
                low, high = min(low, value), max(high, value)
        bounds[row, 0], bounds[row, 1] = low, high


@kernel
def nearest(block, n_blocks, height, width, u, v, depth, bounds, z_min):
    """Lower z_min to the nearest depth among the points with a tap of at least MIN_TAP."""
    top, bottom = height * block // n_blocks, height * (block + 1) // n_blocks
    low, high, right = np.float32(top), np.float32(bottom + 1), np.float32(width + 1)
    band = z_min[block]
    for row in range(u.shape[0]):
        if not (bounds[row, 1] + HALF >= low and bounds[row, 0] + HALF < high):
            continue
        for col in range(u.shape[1]):
            x, y = u[row, col] + HALF, v[row, col] + HALF
            if not (low <= y < high and ZERO <= x < right):
                continue
            ix, iy = int(x), int(y)
            fx, fy = x - np.float32(ix), y - np.float32(iy)
            z = abs(depth[row, col])
            cell = (iy - top) * (width + 2) + ix
            _lower(band, cell, (ONE - fy) * (ONE - fx), z)
            _lower(band, cell + 1, (ONE - fy) * fx, z)
            _lower(band, cell + width + 2, fy * (ONE - fx), z)
            _lower(band, cell + width + 3, fy * fx, z)


@kernel
def splat(
    block,
    n_blocks,
    height,
    width,
    u,
    v,
    depth,
    bounds,
    color,
    inverse_depth,
    zoom,
    subdivision,
    temperature,
    z_min,
    sums,
):
    """Add gain x bilinear x exp(-(z - z_min) / (temperature z_min)) x (r, g, b, z, 1) to sums.

    Args:
        color: [h, w, 3] float32.
        zoom: f_t / f_s; m = zoom z_s / z is a point's magnification, and its gain max(1, m)^2 /
            subdivision^2 makes a magnified surface weigh as much as one seen at par.
    """
    top, bottom = height * block // n_blocks, height * (block + 1) // n_blocks
    low, high, right = np.float32(top), np.float32(bottom + 1), np.float32(width + 1)
    rate = np.float32(1.0 / temperature)
    scale, share = np.float32(zoom), np.float32(1.0 / subdivision**2)
    front, total = z_min[block], sums[block]
    for row in range(u.shape[0]):
        if not (bounds[row, 1] + HALF >= low and bounds[row, 0] + HALF < high):
            continue
        for col in range(u.shape[1]):
            x, y, z = u[row, col] + HALF, v[row, col] + HALF, depth[row, col]
            if not (low <= y < high and ZERO <= x < right and z > ZERO):
                continue
            ix, iy = int(x), int(y)
            fx, fy = x - np.float32(ix), y - np.float32(iy)
            r, g, b = color[row, col, 0], color[row, col, 1], color[row, col, 2]
            magnification = max(ONE, scale / (inverse_depth[row, col] * z))
            gain = magnification * magnification * share
            cell = (iy - top) * (width + 2) + ix
            above, below = gain * (ONE - fy), gain * fy
            _add(total, front, cell, above * (ONE - fx), rate, r, g, b, z)
            _add(total, front, cell + 1, above * fx, rate, r, g, b, z)
            _add(total, front, cell + width + 2, below * (ONE - fx), rate, r, g, b, z)
            _add(total, front, cell + width + 3, below * fx, rate, r, g, b, z)


@inlined
def _lower(band, cell, tap, z):
    index = np.uint64(cell)
    if tap >= MIN_TAP and z < band[index]:
        band[index] = z


@inlined
def _add(total, front, cell, weight, rate, r, g, b, z):
    """One tap. Points more than CUTOFF temperatures behind the nearest one are hidden; one before
    it (its own tap was too small to hide anything) is not attenuated."""
    nearest_z = front[np.uint64(cell)]
    if z > nearest_z:
        behind = (z - nearest_z) * rate
        if behind > CUTOFF * nearest_z:
            return
        weight = weight * _decay(behind / nearest_z)
    index = np.uint64(5 * cell)
    total[index] += weight * r
    total[index + np.uint64(1)] += weight * g
    total[index + np.uint64(2)] += weight * b
    total[index + np.uint64(3)] += weight * z
    total[index + np.uint64(4)] += weight


@inlined
def _decay(x):
    """exp(-x) for 0 <= x <= CUTOFF, as the Taylor polynomial of exp(-x / 8) to the eighth power.

    Within 0.5 % (4e-8 up to x = 1); from plain operations, so the same bits on any platform.
    """
    y = x * np.float32(0.125)
    p = np.float32(1 / 24) - y * np.float32(1 / 120)
    p = np.float32(1 / 6) - y * p
    p = HALF - y * p
    p = ONE - y * (ONE - y * p)
    p = p * p
    p = p * p
    return p * p


@kernel
def resolve(block, n_blocks, sums, min_weight, brightest, image, depth, weight, valid):
    """Divide by the accumulated weight where it is at least `min_weight`; zero elsewhere. What is
    mixed is no brighter than the `brightest`, but for rounding.

    Args:
        image: [3, H, W], depth, weight: [H, W] float32.
        valid: [H, W] bool.
    """
    height, width = weight.shape
    top, bottom = height * block // n_blocks, height * (block + 1) // n_blocks
    total, least, most = sums[block], np.float32(min_weight), np.float32(brightest)
    for row in range(top, bottom):
        for col in range(width):
            k = np.uint64(5 * ((row - top + 1) * (width + 2) + col + 1))
            w = total[k + np.uint64(4)]
            has_depth = w >= least
            inverse = ONE / w if has_depth else ZERO
            image[0, row, col] = min(total[k] * inverse, most)
            image[1, row, col] = min(total[k + np.uint64(1)] * inverse, most)
            image[2, row, col] = min(total[k + np.uint64(2)] * inverse, most)
            depth[row, col] = total[k + np.uint64(3)] * inverse
            weight[row, col] = w
            valid[row, col] = has_depth
