"""Assigns Gaussians to 16x16 tiles, and to rows of them, front to back.

Only the rows that the ellipse alpha >= 1/255 reaches inside a tile's columns are listed, so the
blending loops need no test per row. A list item is two int32. The first is (Gaussian << 8 | last
row << 4 | first row), the second the Gaussian's slot for this tile among those of the tile's strip.
Blocks divide the depth order; a tile's list is ordered by depth for any number of blocks.

The image is divided into strips of whole columns of tiles. One thread differentiates a strip, in a
separate buffer of slots, which is a fraction of all slots. The slots of one Gaussian in a strip are
consecutive and are summed into one "part". The parts of one Gaussian are consecutive too. With more
threads than strips, some threads have nothing to do in this phase.
"""

import math

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    ceil,
    floor,
    load,
    load16,
    maximum,
    minimum,
    neg,
    prefetch,
    splat,
    store,
    store_whole,
    zeros,
)

STRIPS = 16  # at most; fixed, so that no sum can depend on the thread count
MAX_GAUSSIANS = 1 << 23  # what fits beside two rows in an int32

_AHEAD = 32  # Gaussians between asking for what is one's and using it, two sixteens

f4 = np.float32
ZERO, ONE, HALF = f4(0), f4(1), f4(0.5)
_LOG2_255, _TILE = f4(math.log2(255)), f4(1 / 16)


@kernel
def depth_order(rows, bound, keys, spare, order, start):
    """Sort the visible Gaussians (bound > 0) by depth.

    Their indices go into order[:n], and the prefix sums of bound in that order into start[:n + 1].
    It is a stable radix sort of the float bits, since depths are positive. keys and spare are
    uint64 scratch of the same length. Keys next to their indices are read in sequence; rows would
    cause cache misses.

    Returns:
        n and the sum of bound; start can hold sums below 2^31.
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
    return n, total


@inlined
def _edge(at, x0, x1, ellipse, sign):
    """Compute the extreme dy of the upper (sign -1) or lower branch of ellipses in some columns.

    The columns are x0 ... x1 of dx; the extreme point of the whole branch is at dx = at.

    ellipse: (half-sides rx, ry; 1 / rx; b / c; level / c) of a dx^2 + 2 b dx dy + c dy^2 = level.
    In the form c (dy + b/c dx)^2 = level (1 - (dx/rx)^2) nothing cancels. An ellipse may be a point
    (rx = 0): NaN then becomes the neighbouring limit, never more rows than the box has.
    """
    rx, ry, over_rx, shear, height = ellipse
    dx = maximum(minimum(maximum(minimum(at, x1), x0), rx), neg(rx))
    share = dx * over_rx
    root = math.sqrt(maximum(height * (ONE - share * share), zeros()))
    return maximum(minimum(sign * root - shear * dx, ry), neg(ry))


@inlined
def _reached(gathered, width, height, columns, reach):
    """Compute which tiles sixteen ellipses touch.

    gathered: their rows, flat [16 16]. columns: out, [2, 16], first and last column of tiles.
    reach: out, [2, 16 x columns], first and last row of pixels in each of these columns. The first
    is greater than the last if a column has none.
    """
    row = load16(gathered, 0)
    u, v, rx, ry = row[0], row[1], row[10], row[11]
    ellipse = (rx, ry, ONE / rx, row[15], neg(row[5] + _LOG2_255) / row[4])
    summit = -HALF * row[3] / row[2] * ry  # dx of the ellipse's lowest point (largest dy)
    left = floor(maximum(ceil(u - rx - HALF), zeros()) * _TILE)
    right = floor(minimum(floor(u + rx - HALF), splat(f4(width - 1))) * _TILE)
    store_whole(columns[0], 0, left)
    store_whole(columns[1], 0, right)
    widest, o = 0, splat(ONE)
    for lane in range(LANES):
        widest = max(widest, columns[1, lane] - columns[0, lane] + 1)
    for j in range(widest):
        x0 = f4(16) * (left + f4(j)) + HALF - u
        x1 = x0 + f4(15)
        top = ceil(v + _edge(neg(summit), x0, x1, ellipse, -ONE) - HALF)
        bottom = floor(v + _edge(summit, x0, x1, ellipse, ONE) - HALF)
        # either is within or just outside the image: a larger one may be no int32
        store_whole(reach[0], j * LANES, minimum(maximum(top, zeros()), splat(f4(height))))
        store_whole(reach[1], j * LANES, maximum(minimum(bottom, splat(f4(height - 1))), neg(o)))


@kernel
def count_tiles(block, blocks, n, size, rows, strips, items, listed, counts):
    """List the tiles of the Gaussians order[k], for the k of this block.

    items[start[k]...] receives (tile << 9 | 256 where a part begins | last row << 4 | first row).
    touched[k] is the number of tiles and n_parts[k] the number of strips. histogram[block, tile],
    strip_items[block, strip] and strip_parts[block, strip] count items and parts.

    Args:
        size: width and height.
        strips: the strip of every tile.
        listed: order, start, touched and n_parts.
        counts: histogram, strip_items and strip_parts.
    """
    width, height = size
    order, start, touched, n_parts = listed
    histogram, strip_items, strip_parts = counts
    n_columns = (width + 15) // 16
    histogram[block, :], strip_items[block, :], strip_parts[block, :] = 0, 0, 0
    flat = rows.reshape(-1)
    gathered, columns = np.zeros(LANES * LANES, np.float32), np.empty((2, LANES), np.int32)
    reach = np.empty((2, n_columns * LANES), np.int32)
    end = n * (block + 1) // blocks
    for base in range(n * block // blocks, end, LANES):
        for k in range(base, min(base + LANES, end)):
            prefetch(flat, order[min(k + _AHEAD, n - 1)] * 16)
            store(gathered, (k - base) * 16, load(flat, order[k] * 16))
        _reached(gathered, width, height, columns, reach)
        for lane in range(min(LANES, end - base)):
            at, strip, count = start[base + lane], -1, 0
            first_column = columns[0, lane]
            for column in range(first_column, columns[1, lane] + 1):
                place = (column - first_column) * LANES + lane
                top, bottom = reach[0, place], reach[1, place]
                if top > bottom:
                    continue
                begins = 0
                if strips[column] != strip:
                    strip, begins = strips[column], 256
                    strip_parts[block, strip] += 1
                    count += 1
                upper, lower = top >> 4, bottom >> 4
                strip_items[block, strip] += lower - upper + 1
                for band in range(upper, lower + 1):
                    tile = band * n_columns + column
                    first = max(0, top - band * 16)
                    last = min(15, bottom - band * 16)
                    items[at] = tile << 9 | begins | last << 4 | first
                    histogram[block, tile] += 1
                    begins = 0
                    at += 1
            k = base + lane
            touched[k], n_parts[k] = at - start[k], count


@inlined
def _places(counts, offsets):
    """counts [block, list] becomes every block's first place in each of the lists, which follow one
    another; offsets [lists + 1]: where they begin."""
    place = 0
    for i in range(counts.shape[1]):
        offsets[i] = place
        for block in range(counts.shape[0]):
            count = counts[block, i]
            counts[block, i] = place
            place += count
    offsets[counts.shape[1]] = place


@kernel
def prefix_tiles(n, listed, first, counts, ends):
    """Turn counts into first positions; `listed` and `counts` as in `count_tiles`.

    For every block, histogram becomes its first position in the tiles' lists, which begin at
    offsets. strip_parts becomes that in the strips' lists of parts, which begin at bounds.
    strip_items becomes that among a strip's n_slots slots.

    Args:
        first: [N + 1], out, a Gaussian's first part.
        ends: offsets, bounds and n_slots, out.
    """
    order, _, _, n_parts = listed
    histogram, strip_items, strip_parts = counts
    offsets, bounds, n_slots = ends
    first[:] = 0
    for k in range(n):  # here: threads that scatter into one array wait for each other's lines
        first[order[k]] = n_parts[k]
    total = 0
    for i in range(len(first)):
        count = first[i]
        first[i] = total
        total += count
    _places(histogram, offsets)
    _places(strip_parts, bounds)
    for strip in range(strip_items.shape[1]):
        place = 0
        for block in range(strip_items.shape[0]):
            count = strip_items[block, strip]
            strip_items[block, strip] = place
            place += count
        n_slots[strip] = place


@kernel
def fill_tiles(block, blocks, n, strips, items, listed, first, counts, lists_and_parts):
    """Write this block's items into the tiles' lists [items, 2], and its parts into the strips'
    lists [parts, 2]: which part it is, and its first slot."""
    order, start, touched, _ = listed
    histogram, strip_items, strip_parts = counts
    lists, parts = lists_and_parts
    places, next_slot, next_part = histogram[block], strip_items[block], strip_parts[block]
    flat, flat_parts = lists.reshape(-1), parts.reshape(-1)
    for tile in range(0, len(places), LANES):  # another thread wrote these
        prefetch(places, tile)
    for k in range(n * block // blocks, n * (block + 1) // blocks):
        prefetch(first, order[min(k + _AHEAD, n - 1)])
        i = order[k]
        strip, slot, part = 0, next_slot[0], first[i]  # the first item begins a part
        for j in range(start[k], start[k] + touched[k]):
            item = items[j]
            tile = item >> 9
            if item & 256:
                next_slot[strip] = slot
                strip = strips[tile]
                slot, place = next_slot[strip], next_part[strip]
                next_part[strip] = place + 1
                flat_parts[2 * place], flat_parts[2 * place + 1] = part, slot
                part += 1
            place = places[tile]
            places[tile] = place + 1
            flat[2 * place], flat[2 * place + 1] = i << 8 | (item & 255), slot
            slot += 1
        next_slot[strip] = slot


@inlined
def gather(strip, bounds, parts, count, slots, sums):
    """Sum a strip's slots (flat [count 16]) into its parts (flat [parts 16]), in their order."""
    for k in range(bounds[strip], bounds[strip + 1]):
        end = parts[k + 1, 1] if k + 1 < bounds[strip + 1] else count
        total = zeros()
        for j in range(parts[k, 1], end):
            total = total + load(slots, j * 16)
        store(sums, parts[k, 0] * 16, total)
