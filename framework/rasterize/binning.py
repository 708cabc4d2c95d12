"""Which Gaussian touches which 16x16 tile, and in which rows of it, front to back.

Only the rows that the ellipse alpha >= 1/255 reaches inside a tile's columns are listed, so the
blending loops need no test per row. A list item is two int32: (Gaussian << 8 | last row << 4 |
first row) and the Gaussian's slot for this tile. Blocks are over the depth order; a tile's list is
ordered by depth whatever the number of blocks.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.jit import inlined, kernel
from framework.rasterize.simd import prefetch

MAX_GAUSSIANS = 1 << 23  # what fits beside two rows in an int32

_AHEAD = 8  # Gaussians between asking for one's row and using it

f4 = np.float32
ZERO, ONE, HALF = f4(0), f4(1), f4(0.5)
_LOG2_255 = f4(math.log2(255))


@kernel
def depth_order(rows: Any, bound: Any, keys: Any, spare: Any, order: Any, start: Any) -> int:
    """Indices of the visible Gaussians (bound > 0) by depth into order[:n]; start[:n + 1] = prefix
    sums of bound in that order. Returns n.

    Stable radix sort of the float bits (depths are positive); keys and spare are uint64 scratch of
    the same length: a key beside its index is read in sequence, where the row would be a miss.
    """
    bits = rows.view(np.uint32)
    counts = np.zeros((3, 2048), np.int64)
    n = 0
    for i in range(len(rows)):
        if bound[i] > 0:
            key = np.uint64(bits[i, 9])
            keys[n] = key << np.uint64(32) | np.uint64(i)
            n += 1
            counts[0, key & np.uint64(2047)] += 1
            counts[1, (key >> np.uint64(11)) & np.uint64(2047)] += 1
            counts[2, key >> np.uint64(22)] += 1
    for digit in range(3):
        total = 0
        for value in range(2048):
            count = counts[digit, value]
            counts[digit, value] = total
            total += count
        shift = np.uint64(32 + 11 * digit)
        for k in range(n):
            value = (keys[k] >> shift) & np.uint64(2047)
            spare[counts[digit, value]] = keys[k]
            counts[digit, value] += 1
        keys, spare = spare, keys
    total = 0
    for k in range(n):
        i = keys[k] & np.uint64(0xFFFFFFFF)
        order[k] = i
        start[k] = total
        total += bound[i]
    start[n] = total
    return n


@inlined
def _edge(at: Any, x0: Any, x1: Any, ellipse: Any, sign: Any) -> Any:
    """dy of the ellipse's upper (sign -1) or lower branch where it is farthest from dy = 0 in the
    columns x0 ... x1 of dx; its extreme point lies at dx = at.

    ellipse: (half-sides rx, ry; 1 / rx; b / c; level / c) of a dx^2 + 2 b dx dy + c dy^2 = level;
    c (dy + b/c dx)^2 = level (1 - (dx/rx)^2): nothing cancels.
    """
    rx, ry, over_rx, shear, height = ellipse
    if x0 <= at and at <= x1:
        return sign * ry
    dx = max(-rx, min(rx, max(x0, min(x1, at))))
    share = dx * over_rx
    root = math.sqrt(max(ZERO, height * (ONE - share * share)))
    return max(-ry, min(ry, sign * root - shear * dx))


@kernel
def count_tiles(
    block: int,
    blocks: int,
    n: int,
    order: Any,
    rows: Any,
    start: Any,
    width: int,
    height: int,
    items: Any,
    touched: Any,
    histogram: Any,
) -> None:
    """List the tiles of the Gaussian order[k], for the k of this block, into items[start[k]...] as
    (tile << 8 | last row << 4 | first row); touched[order[k]] = how many; histogram[block, tile] is
    the number of items."""
    columns = (width + 15) // 16
    histogram[block, :] = 0
    flat = rows.reshape(-1)
    for k in range(n * block // blocks, n * (block + 1) // blocks):
        i = order[k]
        prefetch(flat, order[min(k + _AHEAD, n - 1)] * 16)
        row = rows[i]
        u, v, rx, ry = row[0], row[1], row[10], row[11]
        left = max(0, int(math.ceil(u - rx - HALF)))
        right = min(width - 1, int(math.floor(u + rx - HALF)))
        ellipse = (rx, ry, ONE / rx, row[15], -(row[5] + _LOG2_255) / row[4])
        summit = -HALF * row[3] / row[2] * ry  # dx of the ellipse's lowest point (largest dy)
        at = start[k]
        for column in range(left // 16, right // 16 + 1):
            x0 = f4(column * 16) + HALF - u
            x1 = x0 + f4(15)
            top = max(0, int(math.ceil(v + _edge(-summit, x0, x1, ellipse, -ONE) - HALF)))
            low = int(math.floor(v + _edge(summit, x0, x1, ellipse, ONE) - HALF))
            bottom = min(height - 1, low)
            if top > bottom:
                continue
            for band in range(top // 16, bottom // 16 + 1):
                tile = band * columns + column
                first = max(0, top - band * 16)
                last = min(15, bottom - band * 16)
                items[at] = tile << 8 | last << 4 | first
                histogram[block, tile] += 1
                at += 1
        touched[i] = at - start[k]


@kernel
def prefix_tiles(touched: Any, first: Any, histogram: Any, offsets: Any) -> int:
    """first [N+1]: a Gaussian's first slot; histogram becomes every block's first place in each
    tile's list; offsets [tiles+1]: where a tile's list begins. Returns the number of items."""
    total = 0
    for i in range(len(touched)):
        first[i] = total
        total += touched[i]
    first[len(touched)] = total
    place = 0
    for tile in range(histogram.shape[1]):
        offsets[tile] = place
        for block in range(histogram.shape[0]):
            count = histogram[block, tile]
            histogram[block, tile] = place
            place += count
    offsets[histogram.shape[1]] = place
    return total


@kernel
def fill_tiles(
    block: int,
    blocks: int,
    n: int,
    order: Any,
    start: Any,
    items: Any,
    first: Any,
    histogram: Any,
    lists: Any,
) -> None:
    """Write this block's items into the tiles' lists [items, 2]."""
    places = histogram[block]
    for k in range(n * block // blocks, n * (block + 1) // blocks):
        i = order[k]
        for j in range(first[i + 1] - first[i]):
            item = items[start[k] + j]
            tile = item >> 8
            place = places[tile]
            places[tile] = place + 1
            lists[place, 0] = i << 8 | (item & 255)
            lists[place, 1] = first[i] + j
