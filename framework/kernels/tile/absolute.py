"""How hard single pixels pull at the projected means, whatever the direction: sums over pixels of
the absolute gradient (AbsGS, Ye et al. 2024, section 3.2), in which pulls that cancel still count.

A pass of its own over the tiles' lists, made only for who asks; see `blend.blend_backward`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    absolute,
    but_not,
    fma,
    fnma,
    greater,
    lane_sums,
    load,
    neg,
    prefetch,
    select,
    splat,
    store,
    zeros,
)
from framework.kernels.tile.binning import gather
from framework.kernels.tile.blend import read_gradients
from framework.kernels.tile.tiles import (
    AHEAD,
    CHECK,
    aligned,
    alive_rows,
    blend_limits,
    clear_outside,
    colour,
    first_alphas,
    listed_rows,
    meet,
    next_run,
    run_of,
    seen_from,
)

f4 = np.float32
ZERO, ONE = f4(0), f4(1)
LN2 = f4(0.6931471805599453)


@inlined
def _slot_pulls(rows: Any, g: int, placed: Any, todo: int, limits: Any, tile: Any) -> Any:
    """Lanes 0 and 1: sums over the rows `todo` of a tile of the absolute gradient in the projected
    mean of Gaussian g; tile: its transmittance, what is behind its pixels and the gradients."""
    transmittance, behind, gr_, gg_, gb_ = tile
    most, one = limits[2], splat(ONE)
    dx, dy0 = placed[0], placed[1]
    # alpha falls from the mean as log(alpha) does, whose coefficients the row has to base 2
    to_u, both_ways, to_v = (splat(f4(-2) * LN2 * rows[g, 2]), splat(-LN2 * rows[g, 3]),
                             splat(f4(-2) * LN2 * rows[g, 4]))  # fmt: skip
    cr, cg, cb = colour(rows, g)
    bend, longest, lean = run_of(rows, g)
    su, sv = zeros(), zeros()
    while todo != 0:
        row, count, todo = next_run(todo, longest)
        raw, ratio = first_alphas(placed, lean, row, count)
        dy = dy0 + splat(f4(row))
        for at in range(row * 16, (row + count) * 16, 16):
            t = load(transmittance, at)
            a, weight, goes_on, left = meet(t, raw, limits)
            store(transmittance, at, left)
            own = fma(load(gr_, at), cr, fma(load(gg_, at), cg, load(gb_, at) * cb))
            rest = fnma(weight, own, load(behind, at))
            store(behind, at, rest)
            slope = fma(t, own, neg(rest / (one - a)))
            pull = select(but_not(goes_on, greater(raw, most)), slope * a, zeros())
            su = su + absolute(pull * fma(to_u, dx, both_ways * dy))
            sv = sv + absolute(pull * fma(both_ways, dx, to_v * dy))
            raw, ratio, dy = raw * ratio, ratio * bend, dy + one
    o = zeros()
    return lane_sums((su, sv, o, o, o, o, o, o, o, o))


@kernel
def blend_absolute(
    block: int,
    blocks: int,
    slots: Any,
    width: int,
    height: int,
    rows: Any,
    offsets: Any,
    lists: Any,
    strips: Any,
    bounds: Any,
    parts: Any,
    n_slots: Any,
    rgb: Any,
    g_rgb: Any,
    nothing: Any,
    sums: Any,
) -> None:
    """Fill every (Gaussian, strip) part of strip `block` (flat [parts 16]) with the sums of
    `_slot_pulls`. rgb, g_rgb: the image and the loss's gradient in it, flat [3 H W]. nothing: flat
    [0]."""
    columns = (width + 15) // 16
    state = aligned(8 * 256)
    transmittance, behind, held = state[:256], state[256:512], state[1792:2048]
    buffers = (
        state[512:768],
        state[768:1024],
        state[1024:1280],
        state[1280:1536],
        state[1536:1792],
    )
    of_tile = (transmittance, behind, buffers[0], buffers[1], buffers[2])
    size, image, gradient = (width, height), (rgb, nothing, nothing), (g_rgb, nothing, nothing)
    limits = blend_limits()
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(len(offsets) - 1):
        if strips[tile] != block:
            continue
        x, y = (tile % columns) * 16, (tile // columns) * 16
        clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        read_gradients(x, y, size, image, gradient, behind, buffers, held)
        alive = 1
        for k in range(offsets[tile], offsets[tile + 1]):
            if alive != 0 and (k - offsets[tile]) % CHECK == 0:
                alive = alive_rows(transmittance)
            slot = lists[k, 1] * 16
            if alive == 0:
                store(slots, slot, zeros())
                continue
            item = lists[k, 0]
            prefetch(flat, (lists[min(k + AHEAD, last), 0] >> 8) * 16)
            g, todo = item >> 8, listed_rows(item) & alive
            placed = seen_from(rows, g, x, y)
            store(slots, slot, _slot_pulls(rows, g, placed, todo, limits, of_tile))
    gather(block, bounds, parts, n_slots[block], slots, sums)
