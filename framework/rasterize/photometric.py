"""L1 + SSIM and its gradient, by rows: three passes, each over blocks of (channel, row) units.

SSIM (Wang et al. 2004) as 3DGS trains with it: 11x11 Gaussian window, sigma 1.5, zero padding,
C1 = 0.01^2, C2 = 0.03^2, variance E[x^2] - mu^2. With mu, q = E[a^2], r = E[ab] the window's blurs,
SSIM = (2 mu mu' + C1)(2 (r - mu mu') + C2) / ((mu^2 + mu'^2 + C1)(q - mu^2 + var' + C2)); the
gradient in the image is the blur (self-adjoint) of the partial derivatives in mu, q and r.

Buffers `blurs` [6, C, H + 10, W]: horizontal blurs of a, a^2, ab, then of the three partials; five
zero rows above and below stand for the padding.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from framework.jit import kernel
from framework.rasterize.simd import lane_sums, load, store, zeros

f4 = np.float32

_taps = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
WINDOW = (_taps / _taps.sum()).astype(np.float32)
_W0, _W1, _W2, _W3, _W4, _W5 = (f4(w) for w in WINDOW[:6])
_C1, _C2 = f4(0.01**2), f4(0.03**2)
ZERO, ONE, TWO = f4(0), f4(1), f4(2)


@kernel
def _across(source: Any, target: Any, n: int) -> None:
    """target[x] = sum of WINDOW x source[x ... x + 10]."""
    for x in range(n):
        target[x] = (
            _W0 * (source[x] + source[x + 10])
            + _W1 * (source[x + 1] + source[x + 9])
            + _W2 * (source[x + 2] + source[x + 8])
            + _W3 * (source[x + 3] + source[x + 7])
            + _W4 * (source[x + 4] + source[x + 6])
            + _W5 * source[x + 5]
        )


@kernel
def _down(plane: Any, y: int, target: Any, n: int) -> None:
    """target[x] = sum of WINDOW x plane[y ... y + 10, x]."""
    r0, r1, r2, r3, r4 = plane[y], plane[y + 1], plane[y + 2], plane[y + 3], plane[y + 4]
    r5, r6, r7, r8, r9 = plane[y + 5], plane[y + 6], plane[y + 7], plane[y + 8], plane[y + 9]
    r10 = plane[y + 10]
    for x in range(n):
        target[x] = (
            _W0 * (r0[x] + r10[x])
            + _W1 * (r1[x] + r9[x])
            + _W2 * (r2[x] + r8[x])
            + _W3 * (r3[x] + r7[x])
            + _W4 * (r4[x] + r6[x])
            + _W5 * r5[x]
        )


@kernel
def _sum(values: Any) -> Any:
    """Sum of a flat array whose length is a multiple of 16, in a fixed order."""
    total = zeros()
    for i in range(0, len(values), 16):
        total = total + load(values, i)
    out = np.empty(16, np.float32)
    store(out, 0, lane_sums((total,)))
    return out[0]


@kernel
def blur_rows(block: int, blocks: int, a: Any, b: Any, mask: Any, blurs: Any) -> None:
    """Pass 1: horizontal blurs of (mask a), (mask a)^2 and (mask a) b; b is already masked."""
    channels, height, width = a.shape
    padded = np.zeros((3, width + 10), np.float32)
    p0, p1, p2 = padded[0], padded[1], padded[2]
    units = channels * height
    for unit in range(units * block // blocks, units * (block + 1) // blocks):
        c, y = unit // height, unit % height
        row, other, valid = a[c, y], b[c, y], mask[y]
        for x in range(width):
            value = row[x] * valid[x]
            p0[x + 5] = value
            p1[x + 5] = value * value
            p2[x + 5] = value * other[x]
        _across(p0, blurs[0, c, y + 5], width)
        _across(p1, blurs[1, c, y + 5], width)
        _across(p2, blurs[2, c, y + 5], width)


@kernel
def statistics_rows(block: int, blocks: int, blurs: Any, mean: Any, variance: Any) -> None:
    """Of a target b, after `blur_rows` with a = b: its window's mean and variance [C, H, W]."""
    channels, height, width = mean.shape
    units = channels * height
    for unit in range(units * block // blocks, units * (block + 1) // blocks):
        c, y = unit // height, unit % height
        mu, spread = mean[c, y], variance[c, y]
        _down(blurs[0, c], y, mu, width)
        _down(blurs[1, c], y, spread, width)
        for x in range(width):
            spread[x] -= mu[x] * mu[x]


@kernel
def ssim_rows(
    block: int, blocks: int, mu_b: Any, variance_b: Any, blurs: Any, ssim_sums: Any
) -> None:
    """Pass 2: SSIM per row into ssim_sums [C, H]; horizontal blurs of its partial derivatives."""
    channels, height, width = mu_b.shape
    mu, q, r = (
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
    )
    values = np.zeros((width + 15) // 16 * 16, np.float32)
    padded = np.zeros((3, width + 10), np.float32)
    p0, p1, p2 = padded[0], padded[1], padded[2]
    units = channels * height
    for unit in range(units * block // blocks, units * (block + 1) // blocks):
        c, y = unit // height, unit % height
        _down(blurs[0, c], y, mu, width)
        _down(blurs[1, c], y, q, width)
        _down(blurs[2, c], y, r, width)
        mu_row, variance_row = mu_b[c, y], variance_b[c, y]
        for x in range(width):
            m1, m2 = mu[x], mu_row[x]
            top_l = TWO * m1 * m2 + _C1
            top_r = TWO * (r[x] - m1 * m2) + _C2
            over_l = ONE / (m1 * m1 + m2 * m2 + _C1)
            over_r = ONE / (q[x] - m1 * m1 + variance_row[x] + _C2)
            ratio = over_l * over_r
            value = top_l * top_r * ratio
            values[x] = value
            d_top_l, d_top_r = top_r * ratio, top_l * ratio
            d_over_l, d_over_r = -value * over_l, -value * over_r
            p0[x + 5] = TWO * (m2 * (d_top_l - d_top_r) + m1 * (d_over_l - d_over_r))
            p1[x + 5] = d_over_r
            p2[x + 5] = TWO * d_top_r
        ssim_sums[c, y] = _sum(values)
        _across(p0, blurs[3, c, y + 5], width)
        _across(p1, blurs[4, c, y + 5], width)
        _across(p2, blurs[5, c, y + 5], width)


@kernel
def gradient_rows(
    block: int,
    blocks: int,
    a: Any,
    b: Any,
    mask: Any,
    blurs: Any,
    ssim_weight: Any,
    scale: Any,
    l1_sums: Any,
    gradient: Any,
) -> None:
    """Pass 3: |mask a - b| per row into l1_sums [C, H]; gradient [C, H, W] of
    scale x ((1 - w) sum |mask a - b| - w sum SSIM) in a."""
    channels, height, width = a.shape
    mu, q, r = (
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
    )
    values = np.zeros((width + 15) // 16 * 16, np.float32)
    keep = (ONE - ssim_weight) * scale
    pull = ssim_weight * scale
    units = channels * height
    for unit in range(units * block // blocks, units * (block + 1) // blocks):
        c, y = unit // height, unit % height
        _down(blurs[3, c], y, mu, width)
        _down(blurs[4, c], y, q, width)
        _down(blurs[5, c], y, r, width)
        row, other, valid, out = a[c, y], b[c, y], mask[y], gradient[c, y]
        for x in range(width):
            value = row[x] * valid[x]
            difference = value - other[x]
            values[x] = abs(difference)
            sign = ONE if difference > ZERO else (-ONE if difference < ZERO else ZERO)
            bent = mu[x] + TWO * value * q[x] + other[x] * r[x]
            out[x] = valid[x] * (keep * sign - pull * bent)
        l1_sums[c, y] = _sum(values)
