"""Front-to-back blending of a tile's list, its gradient, and its second moments.

A tile is 16 rows of 16 lanes; per row the state is the transmittance T and the accumulated colour
and depth. A finished pixel keeps its T with a minus sign, so that it blends nothing more. The loops
over rows have no branch, only masks; they visit the rows that an item reaches and that were not
finished at the last look.

Gradients (Kerbl et al. 2023, appendix; front to back): with w_i = T_i alpha_i and
S = sum over what lies behind, background included, d C / d alpha_i = T_i c_i - S / (1 - alpha_i).
The background enters as the initial value of S, which is the finished pixel itself.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from framework.jit import inlined, kernel
from framework.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from framework.rasterize.simd import (
    absolute,
    any_lane,
    both,
    but_not,
    exp2,
    fma,
    fnma,
    greater,
    greater_equal,
    iota,
    lane_sums,
    load,
    lowest_bit,
    minimum,
    neg,
    prefetch,
    select,
    splat,
    store,
    zeros,
)

f4 = np.float32
HALF, ZERO, ONE = f4(0.5), f4(0), f4(1)
_CUT = f4(np.log2(ALPHA_MIN))  # in the exponent
_MAX = f4(ALPHA_MAX)
_STOP = f4(TRANSMITTANCE_MIN)
_CHECK = 16  # items between two looks at which rows are finished
_AHEAD = 6  # items between asking for a Gaussian's row and using it


@inlined
def _aligned(size: int) -> Any:
    """Uninitialised float32 scratch that begins on a cache line: a vector access that straddles two
    lines costs twice."""
    scratch = np.empty(size + 15, np.float32)
    skip = (-(scratch.ctypes.data // 4)) % 16
    return scratch[skip : skip + size]


@inlined
def _row_numbers() -> Any:
    """[256], the row of every pixel of a tile."""
    numbers = np.empty(256, np.float32)
    for i in range(256):
        numbers[i] = f4(i // 16)
    return numbers


@inlined
def _alive_rows(transmittance: Any) -> int:
    """Bit y is set if a pixel of row y of the tile (flat [256]) still blends."""
    rows = 0
    for y in range(16):
        if any_lane(greater(load(transmittance, y * 16), zeros())):
            rows |= 1 << y
    return rows


@inlined
def _listed_rows(item: Any) -> int:
    """Bits first row ... last row of a list item."""
    return ((2 << ((item >> 4) & 15)) - 1) & ~((1 << (item & 15)) - 1)


@inlined
def _clear_outside(transmittance: Any, x: int, y: int, width: int, height: int) -> None:
    """T = 1 in the image, 0 (finished) for the lanes and rows of the tile outside it."""
    for j in range(16):
        for i in range(16):
            inside = x + i < width and y + j < height
            transmittance[j * 16 + i] = ONE if inside else ZERO


@inlined
def _read_row(plane: Any, at: int, count: int, buffer: Any, place: int) -> None:
    """Copy `count` of 16 values of a flat image into a flat tile buffer, zeros for the rest."""
    if count == 16:
        store(buffer, place, load(plane, at))
    else:
        for i in range(16):
            buffer[place + i] = plane[at + i] if i < count else ZERO


@inlined
def _write_row(plane: Any, at: int, count: int, value: Any, scratch: Any) -> None:
    """Write the first `count` lanes into a flat image."""
    if count == 16:
        store(plane, at, value)
    else:
        store(scratch, 0, value)
        for i in range(count):
            plane[at + i] = scratch[i]


@inlined
def _placed(rows: Any, g: int, x: int, y: int) -> tuple[Any, Any, Any, Any, Any, Any]:
    """A Gaussian as the rows of the tile at (x, y) see it: dx of their lanes, dy of the first row,
    and the four coefficients of `_power`."""
    dx = iota() + splat(f4(x) + HALF - rows[g, 0])
    dy0 = splat(f4(y) + HALF - rows[g, 1])
    return dx, dy0, splat(rows[g, 2]) * dx, splat(rows[g, 3]), splat(rows[g, 4]), splat(rows[g, 5])


@inlined
def _power(dx: Any, dy: Any, slant: Any, shear: Any, fall: Any, peak: Any) -> Any:
    """log2(alpha) at (dx, dy) from the mean."""
    return fma(fma(shear, dy, slant), dx, fma(fall * dy, dy, peak))


@inlined
def _colour(rows: Any, g: int) -> tuple[Any, Any, Any]:
    return splat(rows[g, 6]), splat(rows[g, 7]), splat(rows[g, 8])


@inlined
def _met(t: Any, power: Any, limits: Any) -> tuple[Any, ...]:
    """A pixel with transmittance t and a Gaussian of alpha 2^power: (alpha before and after its
    limit, weight, whether it blends, the pixel's next t). limits: cut, stop and most of alpha."""
    cut, stop, most = limits
    active = both(greater_equal(power, cut), greater(t, zeros()))
    raw = exp2(power)
    a = minimum(raw, most)
    goes_on = both(active, greater_equal(fnma(t, a, t), stop))
    weight = select(goes_on, a * t, zeros())
    kept = t - weight
    return raw, a, weight, goes_on, select(but_not(active, goes_on), neg(kept), kept)


@kernel
def blend(
    block: int,
    blocks: int,
    width: int,
    height: int,
    rows: Any,
    offsets: Any,
    lists: Any,
    background: Any,
    rgb: Any,
    alpha: Any,
    depth: Any,
) -> None:
    """Render tiles block, block + blocks, ...; rgb flat [3 H W], alpha and depth flat [H W]; depth
    may be empty: it is left out then, which saves a tenth of the time here."""
    with_depth = len(depth) > 0
    columns = (width + 15) // 16
    plane = width * height
    state = _aligned(5 * 256 + 16)
    transmittance = state[:256]
    red, green, blue = state[256:512], state[512:768], state[768:1024]
    far, scratch = state[1024:1280], state[1280:]
    limits, one = (splat(_CUT), splat(_STOP), splat(_MAX)), splat(ONE)
    down = _row_numbers()
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(block, len(offsets) - 1, blocks):
        x, y = (tile % columns) * 16, (tile // columns) * 16
        _clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        for k in range(offsets[tile], offsets[tile + 1]):
            if (k - offsets[tile]) % _CHECK == 0:
                alive = _alive_rows(transmittance)
                if alive == 0:
                    break
            item = lists[k, 0]
            prefetch(flat, (lists[min(k + _AHEAD, last), 0] >> 8) * 16)
            g = item >> 8
            dx, dy0, slant, shear, fall, peak = _placed(rows, g, x, y)
            cr, cg, cb = _colour(rows, g)
            cz = splat(rows[g, 9])
            todo = _listed_rows(item) & alive
            while todo != 0:
                at = lowest_bit(todo) * 16
                todo &= todo - 1
                dy = dy0 + splat(down[at])
                power = _power(dx, dy, slant, shear, fall, peak)
                t = load(transmittance, at)
                _, _, weight, _, left = _met(t, power, limits)
                store(transmittance, at, left)
                store(red, at, fma(weight, cr, load(red, at)))
                store(green, at, fma(weight, cg, load(green, at)))
                store(blue, at, fma(weight, cb, load(blue, at)))
                if with_depth:
                    store(far, at, fma(weight, cz, load(far, at)))
        count = min(16, width - x)
        br, bg, bb = splat(background[0]), splat(background[1]), splat(background[2])
        for row in range(min(16, height - y)):
            at, place = row * 16, (y + row) * width + x
            t = absolute(load(transmittance, at))
            _write_row(rgb, place, count, fma(t, br, load(red, at)), scratch)
            _write_row(rgb, plane + place, count, fma(t, bg, load(green, at)), scratch)
            _write_row(rgb, 2 * plane + place, count, fma(t, bb, load(blue, at)), scratch)
            _write_row(alpha, place, count, one - t, scratch)
            if with_depth:
                _write_row(depth, place, count, load(far, at), scratch)


@inlined
def _weigh(
    total: Any, g: Any, plane: Any, place: int, count: int, buffer: Any, held: Any, at: int
) -> Any:
    """total + g x plane for a row of a tile; keeps g in its buffer. held: scratch."""
    _read_row(g, place, count, buffer, at)
    _read_row(plane, place, count, held, at)
    return fma(load(buffer, at), load(held, at), total)


@kernel
def blend_backward(
    block: int,
    blocks: int,
    width: int,
    height: int,
    rows: Any,
    offsets: Any,
    lists: Any,
    rgb: Any,
    depth: Any,
    alpha: Any,
    g_rgb: Any,
    g_alpha: Any,
    g_depth: Any,
    slots: Any,
) -> None:
    """Fill every (tile, Gaussian) slot [16] with the sums described in `project_backward`.

    slots is flat. g_alpha, g_depth: flat [H W], or both empty, for a loss of the colours alone.
    """
    colour_alone = len(g_alpha) == 0
    columns = (width + 15) // 16
    plane = width * height
    state = _aligned(8 * 256)
    transmittance, behind = state[:256], state[256:512]
    gr_, gg_, gb_ = state[512:768], state[768:1024], state[1024:1280]
    ga_, gz_, held = state[1280:1536], state[1536:1792], state[1792:2048]
    limits, most, one = (splat(_CUT), splat(_STOP), splat(_MAX)), splat(_MAX), splat(ONE)
    down = _row_numbers()
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(block, len(offsets) - 1, blocks):
        x, y = (tile % columns) * 16, (tile // columns) * 16
        _clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        count = min(16, width - x)
        for row in range(min(16, height - y)):
            at, place = row * 16, (y + row) * width + x
            total = _weigh(zeros(), g_rgb, rgb, place, count, gr_, held, at)
            total = _weigh(total, g_rgb, rgb, plane + place, count, gg_, held, at)
            total = _weigh(total, g_rgb, rgb, 2 * plane + place, count, gb_, held, at)
            if not colour_alone:
                total = _weigh(total, g_alpha, alpha, place, count, ga_, held, at)
                total = _weigh(total, g_depth, depth, place, count, gz_, held, at)
            store(behind, at, total)
        alive = 1
        for k in range(offsets[tile], offsets[tile + 1]):
            if alive != 0 and (k - offsets[tile]) % _CHECK == 0:
                alive = _alive_rows(transmittance)
            slot = lists[k, 1] * 16
            if alive == 0:
                store(slots, slot, zeros())
                continue
            item = lists[k, 0]
            prefetch(flat, (lists[min(k + _AHEAD, last), 0] >> 8) * 16)
            g = item >> 8
            dx, dy0, slant, shear, fall, peak = _placed(rows, g, x, y)
            cr, cg, cb = _colour(rows, g)
            cz = splat(rows[g, 9])
            m0, m1, m2 = zeros(), zeros(), zeros()
            sr, sg, sb, sz = zeros(), zeros(), zeros(), zeros()
            todo = _listed_rows(item) & alive
            while todo != 0:
                at = lowest_bit(todo) * 16
                todo &= todo - 1
                dy = dy0 + splat(down[at])
                power = _power(dx, dy, slant, shear, fall, peak)
                t = load(transmittance, at)
                raw, a, weight, goes_on, left = _met(t, power, limits)
                store(transmittance, at, left)
                gr, gg, gb = load(gr_, at), load(gg_, at), load(gb_, at)
                own = fma(gr, cr, fma(gg, cg, gb * cb))
                if not colour_alone:
                    gz = load(gz_, at)
                    own = own + fma(gz, cz, load(ga_, at))
                    sz = fma(weight, gz, sz)
                rest = fnma(weight, own, load(behind, at))
                store(behind, at, rest)
                slope = fma(t, own, neg(rest / (one - a)))
                pull = select(but_not(goes_on, greater(raw, most)), slope * a, zeros())
                pull_y = pull * dy
                m0, m1, m2 = m0 + pull, m1 + pull_y, fma(pull_y, dy, m2)
                sr, sg = fma(weight, gr, sr), fma(weight, gg, sg)
                sb = fma(weight, gb, sb)
            m0x = m0 * dx
            sums = lane_sums((m0, m0x, m0x * dx, m1, m1 * dx, m2, sr, sg, sb, sz))
            store(slots, slot, sums)


@inlined
def _fourth_order(dx: Any, m0: Any, m1: Any, m2: Any, m3: Any, m4: Any) -> tuple[Any, ...]:
    """The 15 products of order 0 to 4 from those with powers of e alone, m_j = sum of q e^j."""
    m0x, m1x, m2x = m0 * dx, m1 * dx, m2 * dx
    m0xx, m1xx = m0x * dx, m1x * dx
    m0xxx = m0xx * dx
    second = (m0, m0x, m1, m0xx, m1x, m2)
    return (*second, m0xxx, m1xx, m2x, m3, m0xxx * dx, m1xx * dx, m2x * dx, m3 * dx, m4)


@kernel
def blend_moments(
    block: int,
    blocks: int,
    width: int,
    height: int,
    rows: Any,
    offsets: Any,
    lists: Any,
    rgb: Any,
    slots: Any,
    slopes: Any,
    cross: Any,
) -> None:
    """Second moments of the image's derivatives: the Fisher information in screen coordinates.

    With q = sum over channels of (alpha d C / d alpha)^2 and e = dy + (B / C) dx, the offset from
    the line on which a needle lies (A, B, C: the conic), slot lanes 0-14 are the sums over pixels
    of q times dx^i e^j, ordered 1; dx, e; dx^2, dx e, e^2; dx^3 ... e^3; dx^4 ... e^4, and lane 15
    is the sum of weight^2 (the information on each colour channel). With dy in the place of e, what
    a long thin Gaussian tells about its width would be lost in rounding.

    With view-dependent colour (`slopes` flat [N, 16], `cross` like slots; both else empty) lanes
    0-4 of `cross` are the sums of r times dx, e, dx^2, dx e, e^2, where r is the sum over the
    channels of weight x slope x alpha d C / d alpha, slopes 0, 2, 4; lanes 5-9 with 1, 3, 5.
    """
    directional = len(cross) > 0
    columns = (width + 15) // 16
    plane = width * height
    state = _aligned(6 * 256)
    transmittance = state[:256]
    br, bg, bb = state[256:512], state[512:768], state[768:1024]
    limits, most, one = (splat(_CUT), splat(_STOP), splat(_MAX)), splat(_MAX), splat(ONE)
    first, second = state[1024:1280], state[1280:]  # of the two sums r
    downs = _aligned(16)  # every row's dy, as broadcasts from memory cost nothing
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(block, len(offsets) - 1, blocks):
        x, y = (tile % columns) * 16, (tile // columns) * 16
        _clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        count = min(16, width - x)
        for row in range(min(16, height - y)):
            at, place = row * 16, (y + row) * width + x
            _read_row(rgb, place, count, br, at)
            _read_row(rgb, plane + place, count, bg, at)
            _read_row(rgb, 2 * plane + place, count, bb, at)
        alive = 1
        for k in range(offsets[tile], offsets[tile + 1]):
            if alive != 0 and (k - offsets[tile]) % _CHECK == 0:
                alive = _alive_rows(transmittance)
            slot = lists[k, 1] * 16
            if alive == 0:
                store(slots, slot, zeros())
                if directional:
                    store(cross, slot, zeros())
                continue
            item = lists[k, 0]
            ahead = (lists[min(k + _AHEAD, last), 0] >> 8) * 16
            prefetch(flat, ahead)
            if directional:
                prefetch(slopes, ahead)
            g = item >> 8
            dx, dy0, slant, shear, fall, peak = _placed(rows, g, x, y)
            cr, cg, cb = _colour(rows, g)
            store(downs, 0, iota() + dy0)
            line = splat(HALF * rows[g, 3] / rows[g, 4]) * dx  # B / C dx
            m0, m1, m2, m3, m4, ww = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
            r0, r1, r2, p0, p1, p2 = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
            if directional:
                own = g * 16
                vr, vg, vb = splat(slopes[own]), splat(slopes[own + 2]), splat(slopes[own + 4])
                wr, wg, wb = splat(slopes[own + 1]), splat(slopes[own + 3]), splat(slopes[own + 5])
            else:
                vr, vg, vb, wr, wg, wb = zeros(), zeros(), zeros(), zeros(), zeros(), zeros()
            todo = _listed_rows(item) & alive
            while todo != 0:
                row = lowest_bit(todo)
                at = row * 16
                todo &= todo - 1
                dy = splat(downs[row])
                power = _power(dx, dy, slant, shear, fall, peak)
                t = load(transmittance, at)
                raw, a, weight, goes_on, left = _met(t, power, limits)
                store(transmittance, at, left)
                odds = select(but_not(goes_on, greater(raw, most)), a / (one - a), zeros())
                sr, sg, sb = load(br, at), load(bg, at), load(bb, at)
                jr, jg, jb = fma(t, cr, neg(sr)), fma(t, cg, neg(sg)), fma(t, cb, neg(sb))
                store(br, at, fnma(weight, cr, sr))
                store(bg, at, fnma(weight, cg, sg))
                store(bb, at, fnma(weight, cb, sb))
                q = odds * odds * fma(jr, jr, fma(jg, jg, jb * jb))
                e = dy + line
                e2 = e * e
                m0, m1, m2 = m0 + q, fma(q, e, m1), fma(q, e2, m2)
                m3, m4 = fma(q, e2 * e, m3), fma(q, e2 * e2, m4)
                ww = fma(weight, weight, ww)
                if directional:
                    pull = weight * odds
                    store(first, at, pull * fma(jr, vr, fma(jg, vg, jb * vb)))
                    store(second, at, pull * fma(jr, wr, fma(jg, wg, jb * wb)))
            if directional:  # another loop: all accumulators together would leave the registers
                todo = _listed_rows(item) & alive
                while todo != 0:
                    row = lowest_bit(todo)
                    todo &= todo - 1
                    e = splat(downs[row]) + line
                    r, p = load(first, row * 16), load(second, row * 16)
                    r0, r1, r2 = r0 + r, fma(r, e, r1), fma(r, e * e, r2)
                    p0, p1, p2 = p0 + p, fma(p, e, p1), fma(p, e * e, p2)
            store(slots, slot, lane_sums((*_fourth_order(dx, m0, m1, m2, m3, m4), ww)))
            if directional:
                r0x, p0x = r0 * dx, p0 * dx
                rs = (r0x, r1, r0x * dx, r1 * dx, r2)
                ps = (p0x, p1, p0x * dx, p1 * dx, p2)
                store(cross, slot, lane_sums(rs + ps))
