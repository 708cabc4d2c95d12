"""Second moments of the derivatives of a tile's image: the Fisher information on the screen.

The pass is like `blend_backward`, with squares instead of products with a loss's gradient.
"""

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    but_not,
    fma,
    fnma,
    greater,
    lane_sums,
    load,
    lowest_bit,
    neg,
    prefetch,
    select,
    splat,
    store,
    zeros,
)
from framework.kernels.tile.binning import gather
from framework.kernels.tile.tiles import (
    AHEAD,
    CHECK,
    aligned,
    alive_rows,
    blend_limits,
    blend_row,
    clear_outside,
    colour,
    first_alphas,
    listed_rows,
    next_run,
    read_row,
    run_of,
    seen_from,
)

f4 = np.float32
ZERO, HALF, ONE = f4(0), f4(0.5), f4(1)


@inlined
def _fourth_order(dx, m0, m1, m2, m3, m4):
    """The 15 products of order 0 to 4 from those with powers of e alone, m_j = sum of q e^j."""
    m0x, m1x, m2x = m0 * dx, m1 * dx, m2 * dx
    m0xx, m1xx = m0x * dx, m1x * dx
    m0xxx = m0xx * dx
    second = (m0, m0x, m1, m0xx, m1x, m2)
    return (*second, m0xxx, m1xx, m2x, m3, m0xxx * dx, m1xx * dx, m2x * dx, m3 * dx, m4)


@inlined
def _cross_sums(first, second, todo, line, dx):
    """A slot of `cross`, see `blend_moments`, from both sums r of the pixels in the rows `todo`."""
    r0, r1, r2, p0, p1, p2 = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
    while todo != 0:
        row = lowest_bit(todo)
        todo &= todo - 1
        e = line + splat(f4(row))
        r, p = load(first, row * 16), load(second, row * 16)
        r0, r1, r2 = r0 + r, fma(r, e, r1), fma(r, e * e, r2)
        p0, p1, p2 = p0 + p, fma(p, e, p1), fma(p, e * e, p2)
    r0x, p0x = r0 * dx, p0 * dx
    return lane_sums((r0x, r1, r0x * dx, r1 * dx, r2, p0x, p1, p0x * dx, p1 * dx, p2))


@inlined
def _read_colours(x, y, width, height, rgb, behind):
    """An image's colours into a tile's."""
    plane, count = width * height, min(16, width - x)
    for row in range(min(16, height - y)):
        at, place = row * 16, (y + row) * width + x
        read_row(rgb, place, count, behind[0], at)
        read_row(rgb, plane + place, count, behind[1], at)
        read_row(rgb, 2 * plane + place, count, behind[2], at)


@inlined
def _hide(x, y, width, height, mask, transmittance):
    """T = 0 (finished) where a mask has no photo."""
    for j in range(min(16, height - y)):
        for i in range(min(16, width - x)):
            if mask[(y + j) * width + x + i] <= HALF:
                transmittance[j * 16 + i] = ZERO


@kernel
def blend_moments(strip, n_strips, slots, mixed, strips, rgb, mask, sums, slopes, cross):
    """Compute second moments of the image's derivatives: Fisher information on the screen.

    Let q = sum over channels of (alpha d C / d alpha)^2. Let e = dy + (B / C) dx: the offset from
    the axis of a thin Gaussian with conic A, B, C. Lanes 0-14 of `sums` are sums over pixels of q
    dx^i e^j, ordered 1; dx, e; dx^2, dx e, e^2; dx^3 ... e^3; dx^4 ... e^4. Lane 15 is the sum of
    weight^2, the information on each colour channel. With dy instead of e, information on the width
    of a thin Gaussian would be lost in rounding.

    With view-dependent colour, lanes 0-4 of `cross` are the sums of r times dx, e, dx^2, dx e, e^2.
    Here r is the sum over the channels of weight x slope x alpha d C / d alpha with slopes 0, 2, 4;
    lanes 5-9 use slopes 1, 3, 5.

    Args:
        slopes: flat [N, 16], cross: like `sums`; both empty without view-dependent colour.
        mask: flat [H W], or empty; pixels at or below 0.5 do not count.
    """
    # One long body: with its first loop over rows, of six arrays, as an inlined function it takes
    # 1.3 to 1.8 times as long (`benchmarks/speed/fisher.py`).
    width, height, rows, offsets, lists, strip_of, bounds, parts, n_slots = strips
    directional = len(cross) > 0
    columns = (width + 15) // 16
    state = aligned(6 * 256)
    transmittance = state[:256]
    br, bg, bb = state[256:512], state[512:768], state[768:1024]
    limits = blend_limits()
    most, one = limits[2], splat(ONE)
    first, second = state[1024:1280], state[1280:]  # of the two sums r
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(len(offsets) - 1):
        if strip_of[tile] != strip:
            continue
        x, y = (tile % columns) * 16, (tile // columns) * 16
        clear_outside(transmittance, x, y, width, height)
        if len(mask) > 0:
            _hide(x, y, width, height, mask, transmittance)
        state[256:] = ZERO
        _read_colours(x, y, width, height, rgb, (br, bg, bb))
        alive = 1
        for k in range(offsets[tile], offsets[tile + 1]):
            if alive != 0 and (k - offsets[tile]) % CHECK == 0:
                alive = alive_rows(transmittance)
            slot = lists[k, 1] * 16
            if alive == 0:
                store(slots, slot, zeros())
                if directional:
                    store(mixed, slot, zeros())
                continue
            item = lists[k, 0]
            ahead = (lists[min(k + AHEAD, last), 0] >> 8) * 16
            prefetch(flat, ahead)
            if directional:
                prefetch(slopes, ahead)
            g = item >> 8
            placed = seen_from(rows, g, x, y)
            dx, dy0 = placed[0], placed[1]
            bend, longest, lean = run_of(rows, g)
            cr, cg, cb = colour(rows, g)
            line = fma(lean, dx, dy0)  # e in the first row
            m0, m1, m2, m3, m4, ww = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
            if directional:
                base = g * 16
                vr, vg, vb = splat(slopes[base]), splat(slopes[base + 2]), splat(slopes[base + 4])
                wr, wg, wb = (
                    splat(slopes[base + 1]),
                    splat(slopes[base + 3]),
                    splat(slopes[base + 5]),
                )
            else:
                vr, vg, vb, wr, wg, wb = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
            todo = listed_rows(item) & alive
            while todo != 0:
                row, count, todo = next_run(todo, longest)
                raw, ratio = first_alphas(placed, lean, row, count)
                e = line + splat(f4(row))
                for at in range(row * 16, (row + count) * 16, 16):
                    t = load(transmittance, at)
                    a, weight, goes_on, left = blend_row(t, raw, limits)
                    store(transmittance, at, left)
                    odds = select(but_not(goes_on, greater(raw, most)), a / (one - a), zeros())
                    sr, sg, sb = load(br, at), load(bg, at), load(bb, at)
                    jr, jg, jb = fma(t, cr, neg(sr)), fma(t, cg, neg(sg)), fma(t, cb, neg(sb))
                    store(br, at, fnma(weight, cr, sr))
                    store(bg, at, fnma(weight, cg, sg))
                    store(bb, at, fnma(weight, cb, sb))
                    q = odds * odds * fma(jr, jr, fma(jg, jg, jb * jb))
                    e2 = e * e
                    m0, m1, m2 = m0 + q, fma(q, e, m1), fma(q, e2, m2)
                    m3, m4 = fma(q, e2 * e, m3), fma(q, e2 * e2, m4)
                    ww = fma(weight, weight, ww)
                    if directional:
                        pull = weight * odds
                        store(first, at, pull * fma(jr, vr, fma(jg, vg, jb * vb)))
                        store(second, at, pull * fma(jr, wr, fma(jg, wg, jb * wb)))
                    raw, ratio, e = raw * ratio, ratio * bend, e + one
            store(slots, slot, lane_sums((*_fourth_order(dx, m0, m1, m2, m3, m4), ww)))
            if directional:  # another loop: all accumulators together would leave the registers
                todo = listed_rows(item) & alive
                store(mixed, slot, _cross_sums(first, second, todo, line, dx))
    gather(strip, bounds, parts, n_slots[strip], slots, sums)
    if directional:
        gather(strip, bounds, parts, n_slots[strip], mixed, cross)
