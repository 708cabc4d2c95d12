"""Front-to-back blending of a tile's list, and its gradient.

Let w_i = T_i alpha_i, and let S be the sum over what lies behind. Then d C / d alpha_i = T_i c_i -
S / (1 - alpha_i) (Kerbl et al. 2023, appendix; front to back). The initial S is the finished pixel,
so the background is part of it.
"""

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
    write_row,
)

f4 = np.float32
ZERO, ONE = f4(0), f4(1)
LN2 = f4(0.6931471805599453)


@inlined
def _composite(rows, g, placed, todo, limits, with_depth, tile):
    """Blend Gaussian g over the rows `todo` of a tile; tile: its transmittance, colours, depth."""
    transmittance, red, green, blue, far = tile
    cr, cg, cb = colour(rows, g)
    cz = splat(rows[g, 9])
    bend, longest, lean = run_of(rows, g)
    while todo != 0:
        row, count, todo = next_run(todo, longest)
        raw, ratio = first_alphas(placed, lean, row, count)
        for at in range(row * 16, (row + count) * 16, 16):
            t = load(transmittance, at)
            _, weight, _, left = blend_row(t, raw, limits)
            store(transmittance, at, left)
            store(red, at, fma(weight, cr, load(red, at)))
            store(green, at, fma(weight, cg, load(green, at)))
            store(blue, at, fma(weight, cb, load(blue, at)))
            if with_depth:
                store(far, at, fma(weight, cz, load(far, at)))
            raw, ratio = raw * ratio, ratio * bend


@inlined
def _write_tile(x, y, size, background, tile, scratch, image):
    """A blended tile on the background, into the image: colours, alpha and depth, which may be
    empty."""
    width, height = size
    rgb, alpha, depth = image
    transmittance, red, green, blue, far = tile
    plane, count = width * height, min(16, width - x)
    br, bg, bb = splat(background[0]), splat(background[1]), splat(background[2])
    for row in range(min(16, height - y)):
        at, place = row * 16, (y + row) * width + x
        t = absolute(load(transmittance, at))
        write_row(rgb, place, count, fma(t, br, load(red, at)), scratch)
        write_row(rgb, plane + place, count, fma(t, bg, load(green, at)), scratch)
        write_row(rgb, 2 * plane + place, count, fma(t, bb, load(blue, at)), scratch)
        write_row(alpha, place, count, splat(ONE) - t, scratch)
        if len(depth) > 0:
            write_row(depth, place, count, load(far, at), scratch)


@kernel
def blend(block, blocks, width, height, rows, offsets, lists, background, rgb, alpha, depth):
    """Render a range of tiles, since neighbours share Gaussians.

    rgb is flat [3 H W], alpha and depth flat [H W]. An empty depth is skipped, which saves a tenth
    of the time.
    """
    with_depth = len(depth) > 0
    columns = (width + 15) // 16
    state = aligned(5 * 256 + 16)
    transmittance, scratch = state[:256], state[1280:]
    planes = (transmittance, state[256:512], state[512:768], state[768:1024], state[1024:1280])
    limits = blend_limits()
    flat = rows.reshape(-1)
    last = len(lists) - 1
    n_tiles = len(offsets) - 1
    for tile in range(n_tiles * block // blocks, n_tiles * (block + 1) // blocks):
        x, y = (tile % columns) * 16, (tile // columns) * 16
        clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        for k in range(offsets[tile], offsets[tile + 1]):
            if (k - offsets[tile]) % CHECK == 0:
                alive = alive_rows(transmittance)
                if alive == 0:
                    break
            along = lists[k, 0]
            prefetch(flat, (lists[min(k + AHEAD, last), 0] >> 8) * 16)
            g, todo = along >> 8, listed_rows(along) & alive
            placed = seen_from(rows, g, x, y)
            _composite(rows, g, placed, todo, limits, with_depth, planes)
        _write_tile(x, y, (width, height), background, planes, scratch, (rgb, alpha, depth))


@inlined
def _weigh(total, g, plane, place, count, buffer, held, at):
    """total + g x plane for a row of a tile; keeps g in its buffer. held: scratch."""
    read_row(g, place, count, buffer, at)
    read_row(plane, place, count, held, at)
    return fma(load(buffer, at), load(held, at), total)


@inlined
def read_gradients(x, y, size, image, gradient, behind, buffers, held):
    """Read the image's gradients into a tile.

    `behind` receives the sum over channels of the gradient times the pixel, its initial S.

    Args:
        image, gradient: colours, alpha, depth; the gradients of the last two may be empty.
        held: scratch.
    """
    width, height = size
    rgb, alpha, depth = image
    g_rgb, g_alpha, g_depth = gradient
    gr, gg, gb, ga, gz = buffers
    plane, count = width * height, min(16, width - x)
    for row in range(min(16, height - y)):
        at, place = row * 16, (y + row) * width + x
        total = _weigh(zeros(), g_rgb, rgb, place, count, gr, held, at)
        total = _weigh(total, g_rgb, rgb, plane + place, count, gg, held, at)
        total = _weigh(total, g_rgb, rgb, 2 * plane + place, count, gb, held, at)
        if len(g_alpha) > 0:
            total = _weigh(total, g_alpha, alpha, place, count, ga, held, at)
            total = _weigh(total, g_depth, depth, place, count, gz, held, at)
        store(behind, at, total)


@inlined
def _slot_sums(rows, g, placed, todo, limits, colour_alone, tile):
    """What Gaussian g gets from the rows `todo` of a tile, see `project_backward`; tile: its
    transmittance, what is behind its pixels and the gradients."""
    transmittance, behind, gr_, gg_, gb_, ga_, gz_ = tile
    most, one = limits[2], splat(ONE)
    dx, dy0 = placed[0], placed[1]
    cr, cg, cb = colour(rows, g)
    cz = splat(rows[g, 9])
    bend, longest, lean = run_of(rows, g)
    m0, m1, m2 = zeros(), zeros(), zeros()
    sr, sg, sb, sz = zeros(), zeros(), zeros(), zeros()
    while todo != 0:
        row, count, todo = next_run(todo, longest)
        raw, ratio = first_alphas(placed, lean, row, count)
        dy = dy0 + splat(f4(row))
        for at in range(row * 16, (row + count) * 16, 16):
            t = load(transmittance, at)
            a, weight, goes_on, left = blend_row(t, raw, limits)
            store(transmittance, at, left)
            gr, gg, gb = load(gr_, at), load(gg_, at), load(gb_, at)
            along = fma(gr, cr, fma(gg, cg, gb * cb))
            if not colour_alone:
                gz = load(gz_, at)
                along = along + fma(gz, cz, load(ga_, at))
                sz = fma(weight, gz, sz)
            rest = fnma(weight, along, load(behind, at))
            store(behind, at, rest)
            slope = fma(t, along, neg(rest / (one - a)))
            pull = select(but_not(goes_on, greater(raw, most)), slope * a, zeros())
            pull_y = pull * dy
            m0, m1, m2 = m0 + pull, m1 + pull_y, fma(pull_y, dy, m2)
            sr, sg = fma(weight, gr, sr), fma(weight, gg, sg)
            sb = fma(weight, gb, sb)
            raw, ratio, dy = raw * ratio, ratio * bend, dy + one
    m0x = m0 * dx
    return lane_sums((m0, m0x, m0x * dx, m1, m1 * dx, m2, sr, sg, sb, sz))


@inlined
def _slot_pulls(rows, g, placed, todo, limits, tile):
    """Sum the absolute gradient in the projected mean of Gaussian g over the rows `todo` of a tile.

    AbsGS (Ye et al. 2024, section 3.2): gradients of opposite sign do not cancel. The sums are in
    lanes 0 and 1.
    """
    transmittance, behind, gr_, gg_, gb_, _, _ = tile
    most, one = limits[2], splat(ONE)
    dx, dy0 = placed[0], placed[1]
    # the row has the coefficients of log2(alpha)
    to_u, to_v = splat(f4(-2) * LN2 * rows[g, 2]), splat(f4(-2) * LN2 * rows[g, 4])
    both_ways = splat(-LN2 * rows[g, 3])
    cr, cg, cb = colour(rows, g)
    bend, longest, lean = run_of(rows, g)
    su, sv = zeros(), zeros()
    while todo != 0:
        row, count, todo = next_run(todo, longest)
        raw, ratio = first_alphas(placed, lean, row, count)
        dy = dy0 + splat(f4(row))
        for at in range(row * 16, (row + count) * 16, 16):
            t = load(transmittance, at)
            a, weight, goes_on, left = blend_row(t, raw, limits)
            store(transmittance, at, left)
            along = fma(load(gr_, at), cr, fma(load(gg_, at), cg, load(gb_, at) * cb))
            rest = fnma(weight, along, load(behind, at))
            store(behind, at, rest)
            slope = fma(t, along, neg(rest / (one - a)))
            pull = select(but_not(goes_on, greater(raw, most)), slope * a, zeros())
            su = su + absolute(pull * fma(to_u, dx, both_ways * dy))
            sv = sv + absolute(pull * fma(both_ways, dx, to_v * dy))
            raw, ratio, dy = raw * ratio, ratio * bend, dy + one
    o = zeros()
    return lane_sums((su, sv, o, o, o, o, o, o, o, o))


@inlined
def _differentiate(strip, slots, strips, image, gradient, sums, pulls):
    """Sum what the Gaussians of a strip get from its pixels: `_slot_pulls` or `_slot_sums`.

    slots: scratch, flat [at least n_slots[strip] 16]. strips: see `Workspace._strips`. image,
    gradient: colours flat [3 H W], alpha and depth flat [H W]. The gradients of the last two may be
    empty. sums: out, of every (Gaussian, strip) part, flat [parts 16].
    """
    width, height, rows, offsets, lists, strip_of, bounds, parts, n_slots = strips
    colour_alone = len(gradient[1]) == 0
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
    of_tile = (transmittance, behind, *buffers)
    limits = blend_limits()
    flat = rows.reshape(-1)
    last = len(lists) - 1
    for tile in range(len(offsets) - 1):
        if strip_of[tile] != strip:
            continue
        x, y = (tile % columns) * 16, (tile // columns) * 16
        clear_outside(transmittance, x, y, width, height)
        state[256:] = ZERO
        read_gradients(x, y, (width, height), image, gradient, behind, buffers, held)
        alive = 1
        for k in range(offsets[tile], offsets[tile + 1]):
            if alive != 0 and (k - offsets[tile]) % CHECK == 0:
                alive = alive_rows(transmittance)
            slot = lists[k, 1] * 16
            if alive == 0:
                store(slots, slot, zeros())
                continue
            along = lists[k, 0]
            prefetch(flat, (lists[min(k + AHEAD, last), 0] >> 8) * 16)
            g, todo = along >> 8, listed_rows(along) & alive
            placed = seen_from(rows, g, x, y)
            if pulls:
                slot_sum = _slot_pulls(rows, g, placed, todo, limits, of_tile)
            else:
                slot_sum = _slot_sums(rows, g, placed, todo, limits, colour_alone, of_tile)
            store(slots, slot, slot_sum)
    gather(strip, bounds, parts, n_slots[strip], slots, sums)


@kernel
def blend_backward(strip, n_strips, slots, strips, image, gradient, sums):
    """Fill the sums described in `project_backward`; arguments as `_differentiate`."""
    _differentiate(strip, slots, strips, image, gradient, sums, False)


@kernel
def blend_absolute(strip, n_strips, slots, strips, image, gradient, sums):
    """Fill the sums of absolute gradients, in an extra pass; arguments as `_differentiate`."""
    _differentiate(strip, slots, strips, image, gradient, sums, True)
