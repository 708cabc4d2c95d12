"""L1 + SSIM and its gradient, in one pass over bands of rows that stay in the cache.

SSIM (Wang et al. 2004) as in 3DGS training: 11x11 Gaussian window, sigma 1.5, zero padding, C1 =
0.01^2, C2 = 0.03^2, variance E[x^2] - mu^2. With the window's blurs mu, q = E[a^2], r = E[ab]:

    SSIM = (2 mu mu' + C1) (2 (r - mu mu') + C2)
         / ((mu^2 + mu'^2 + C1) (q - mu^2 + var' + C2))

The gradient in the image is the blur (self-adjoint) of the partial derivatives in mu, q and r.

Both blurs are horizontal first, then vertical. A band goes down the image by CHUNK rows at a time.
It has two buffers [3, CHUNK + 10, S] of horizontally blurred rows, one of a, a^2, ab and one of the
three partial derivatives. New rows join the last ten, which the vertical windows of the next rows
still need. Rows outside the image are zero. S is a whole number of vectors; values beyond W are
finite and unused.
"""

import numpy as np

from framework.compute import portable
from framework.compute.jit import inlined, kernel
from framework.compute.simd import LANES, fma, lane_sums, load, splat, store, zeros

f4 = np.float32

_taps = portable.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
WINDOW = (_taps / _taps.sum()).astype(np.float32)
_W0, _W1, _W2, _W3, _W4, _W5 = (f4(w) for w in WINDOW[:6])
_C1, _C2 = f4(0.01**2), f4(0.03**2)
ZERO, ONE, TWO = f4(0), f4(1), f4(2)


CHUNK, REACH = 16, 10  # rows that a band advances by; rows that a window of 11 reaches back
STRIP = 8 * LANES  # columns


def stride(width: int) -> int:
    """S: `width` in whole vectors, an odd number of them, so that the rows that a window adds do
    not fall on the same few lines of the cache."""
    return LANES * (-(-width // LANES) | 1)


@inlined
def _window(source, at, step):
    """Sum of WINDOW x source[at], source[at + step] ... source[at + 10 step], sixteen at a time."""
    total = splat(_W5) * load(source, at + 5 * step)
    total = fma(splat(_W4), load(source, at + 4 * step) + load(source, at + 6 * step), total)
    total = fma(splat(_W3), load(source, at + 3 * step) + load(source, at + 7 * step), total)
    total = fma(splat(_W2), load(source, at + 2 * step) + load(source, at + 8 * step), total)
    total = fma(splat(_W1), load(source, at + step) + load(source, at + 9 * step), total)
    return fma(splat(_W0), load(source, at) + load(source, at + 10 * step), total)


@kernel
def _sum(values):
    """Sum of a flat array whose length is a multiple of 16, in a fixed order."""
    total = zeros()
    for i in range(0, len(values), 16):
        total = total + load(values, i)
    out = np.empty(16, np.float32)
    store(out, 0, lane_sums((total,)))
    return out[0]


@kernel
def _across(padded, rows, i):
    """Horizontal blurs of three padded rows into row i of the three planes of `rows`."""
    source, length, wide = padded.reshape(-1), padded.shape[1], rows.shape[2]
    target = rows.reshape(-1)
    for k in range(3):
        at = (k * rows.shape[1] + i) * wide
        for x in range(0, wide, LANES):
            store(target, at + x, _window(source, k * length + x, 1))


@kernel
def _blur_image(a, b, mask, first, count, padded, rows, to):
    """Rows first ... first + count - 1 of (mask a), (mask a)^2 and (mask a) b, horizontally blurred
    into `rows` from row `to` on; b is already masked."""
    height, width = a.shape
    p0, p1, p2 = padded[0], padded[1], padded[2]
    for i in range(count):
        y = first + i
        if y < 0 or y >= height:
            rows[:, to + i] = ZERO
            continue
        row, other, valid = a[y], b[y], mask[y]
        for x in range(width):
            value = row[x] * valid[x]
            p0[x + 5] = value
            p1[x + 5] = value * value
            p2[x + 5] = value * other[x]
        _across(padded, rows, to + i)


@kernel
def _keep_last(rows, count):
    """Move the last REACH of count + REACH rows to the front."""
    for k in range(3):
        for i in range(REACH):
            rows[k, i] = rows[k, i + count]


@kernel
def _down(rows, count, windows):
    """Vertical blurs: row i of the three planes of `windows` from rows i ... i + 10 of `rows`, by
    strips of columns that stay in the first cache."""
    source, target, wide = rows.reshape(-1), windows.reshape(-1), rows.shape[2]
    for k in range(3):
        for left in range(0, wide, STRIP):
            for i in range(count):
                at, to = (k * rows.shape[1] + i) * wide, (k * windows.shape[1] + i) * wide
                for x in range(left, min(left + STRIP, wide), LANES):
                    store(target, to + x, _window(source, at + x, wide))


@kernel
def _ssim_row(blurred, i, mean, variance, values, padded, width):
    """SSIM of a row into `values`, its partial derivatives into `padded`; row i of `blurred` are
    its blurs, mean and variance are the target's."""
    flat, wide = blurred.reshape(-1), blurred.shape[2]
    plane = blurred.shape[1] * wide
    p0, p1, p2 = padded[0], padded[1], padded[2]
    for x in range(0, wide, LANES):
        at = i * wide + x
        m1, m2 = load(flat, at), load(mean, x)
        cross, square = m1 * m2, m1 * m1
        top_l = fma(splat(TWO), cross, splat(_C1))
        top_r = fma(splat(TWO), load(flat, at + 2 * plane) - cross, splat(_C2))
        over_l = ONE / (fma(m2, m2, square) + _C1)
        over_r = ONE / (load(flat, at + plane) - square + load(variance, x) + _C2)
        d_top_l, d_top_r = top_r * (over_l * over_r), top_l * (over_l * over_r)
        value = top_l * d_top_l
        store(values, x, value)
        d_over_r = -value * over_r
        in_mu = m2 * (d_top_l - d_top_r) - m1 * fma(value, over_l, d_over_r)
        store(p0, x + 5, TWO * in_mu)
        store(p1, x + 5, d_over_r)
        store(p2, x + 5, TWO * d_top_r)
    values[width:] = ZERO  # beyond the image there is nothing
    padded[:, width + 5 :] = ZERO


@kernel
def _partial_rows(
    blurred, first, count, counted, target, width, windows, derived, values, partials, to, sums
):
    """Blur the partial derivatives of a range of rows horizontally, and sum SSIM for each row.

    Rows first ... first + count - 1 of the band go into `partials` from row `to` on.

    target: mean and variance [H, S] of the target. windows, derived, values: scratch.
    """
    mean, variance = target
    _down(blurred, count, windows)
    for i in range(count):
        y = first + i
        if y < 0 or y >= len(mean):
            partials[:, to + i] = ZERO
            continue
        _ssim_row(windows, i, mean[y], variance[y], values, derived, width)
        if y >= counted[0] and y < counted[1]:
            sums[y] = _sum(values)
        _across(derived, partials, to + i)


@kernel
def _gradient_row(windows, i, near, pulls, values, gradient):
    """Write |mask a - b| of a row into `values`, and compute its gradient.

    Row i of `windows` has the blurs of its partial derivatives. near: the row of a, b and mask.
    pulls: weights of L1 and of SSIM.
    """
    a, b, mask = near
    keep, pull = pulls
    mu, q, r = windows[0, i], windows[1, i], windows[2, i]
    for x in range(len(a)):
        value = a[x] * mask[x]
        difference = value - b[x]
        values[x] = abs(difference)
        sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
        bent = mu[x] + TWO * value * q[x] + b[x] * r[x]
        gradient[x] = mask[x] * (keep * sign - pull * bent)


@kernel
def statistics(block, blocks, b, mask, mean, variance):
    """Compute mean and variance [C, H, S] of the windows of a target b [C, H, W].

    Args:
        mask: ones [H, W]. The third blur, of the render times b, is not needed here; a target is
            prepared once.
    """
    channels, height, _ = b.shape
    wide = mean.shape[2]
    blurred = np.empty((3, CHUNK + REACH, wide), np.float32)
    padded = np.zeros((3, wide + LANES), np.float32)
    flat, plane = blurred.reshape(-1), (CHUNK + REACH) * wide
    start, end = channels * height * block // blocks, channels * height * (block + 1) // blocks
    while start < end:
        c, y0 = start // height, start % height
        y1 = min(height, y0 + end - start)
        _blur_image(b[c], b[c], mask, y0 - 5, REACH, padded, blurred, 0)
        for y in range(y0, y1, CHUNK):
            n = min(CHUNK, y1 - y)
            _blur_image(b[c], b[c], mask, y + 5, n, padded, blurred, REACH)
            for i in range(n):
                for x in range(0, wide, LANES):
                    mu = _window(flat, i * wide + x, wide)
                    store(mean[c, y + i], x, mu)
                    q = _window(flat, plane + i * wide + x, wide)
                    store(variance[c, y + i], x, q - mu * mu)
            _keep_last(blurred, n)
        start += y1 - y0


@kernel
def loss_and_gradient(
    block, blocks, a, b, mask, mean, variance, ssim_weight, scale, ssim_sums, l1_sums, gradient
):
    """Compute the loss of an image a [C, H, W] against a masked target b with its `statistics`.

    SSIM and |mask a - b| are summed per row, [C, H] each. The gradient [C, H, W] in a is that of
    scale x ((1 - w) sum |mask a - b| - w sum SSIM).
    """
    channels, height, width = a.shape
    wide = mean.shape[2]
    blurred = np.empty((3, CHUNK + REACH, wide), np.float32)
    partials = np.empty((3, CHUNK + REACH, wide), np.float32)
    padded = np.zeros((3, wide + LANES), np.float32)  # of the image
    derived = np.zeros((3, wide + LANES), np.float32)  # of the partials
    windows, values = np.empty((3, CHUNK, wide), np.float32), np.zeros(wide, np.float32)
    pulls = ((ONE - ssim_weight) * scale, ssim_weight * scale)
    start, end = channels * height * block // blocks, channels * height * (block + 1) // blocks
    while start < end:
        c, y0 = start // height, start % height
        y1 = min(height, y0 + end - start)
        image, target, out, ssim = a[c], b[c], gradient[c], ssim_sums[c]
        of_target = (mean[c], variance[c])
        # before the first chunk: the ten partials that its windows reach back to
        _blur_image(image, target, mask, y0 - REACH, 2 * REACH, padded, blurred, 0)
        n, y, to = REACH, y0 - REACH, 0
        while True:
            _partial_rows(
                blurred,
                y + 5,
                n,
                (y0, y1),
                of_target,
                width,
                windows,
                derived,
                values,
                partials,
                to,
                ssim,
            )
            _keep_last(blurred, n)
            if to > 0:
                _down(partials, n, windows)
                for i in range(n):
                    near = (image[y + i], target[y + i], mask[y + i])
                    _gradient_row(windows, i, near, pulls, values, out[y + i])
                    l1_sums[c, y + i] = _sum(values)
                _keep_last(partials, n)
            y, to = y + n, REACH
            if y >= y1:
                break
            n = min(CHUNK, y1 - y)
            _blur_image(image, target, mask, y + REACH, n, padded, blurred, REACH)
        start += y1 - y0
