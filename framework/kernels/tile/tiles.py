"""Common parts of the passes over a tile's list: rows, masks, and how a pixel meets a Gaussian.

A tile is 16 rows of 16 lanes; per row the state is the transmittance T and what else a pass keeps.
A finished pixel has a negative T, so that it blends nothing more. The loops over rows use masks
instead of branches. They visit the rows that an item reaches and that were not finished at the last
check. These rows decide where alpha is extrapolated (`first_alphas`), equally in every pass, so the
last bits of a pixel depend on its tile.
"""

import math

import numpy as np

from framework.compute.jit import inlined
from framework.compute.simd import (
    absolute,
    any_lane,
    both,
    but_not,
    exp2,
    floor,
    fma,
    fnma,
    greater,
    greater_equal,
    iota,
    load,
    lowest_bit,
    maximum,
    minimum,
    neg,
    select,
    splat,
    store,
    zeros,
)
from framework.kernels.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

f4 = np.float32
HALF, ZERO, ONE = f4(0.5), f4(0), f4(1)
_MIN = f4(ALPHA_MIN)
_MAX = f4(ALPHA_MAX)
_STOP = f4(TRANSMITTANCE_MIN)
_FAINT = f4(-9)  # log2 of an alpha that is less than ALPHA_MIN, whatever the rounding
_LOWEST = f4(124)  # minus the log2 of the least alpha that is kept
CHECK = 16  # items between two looks at which rows are finished
AHEAD = 6  # items between asking for a Gaussian's row and using it


@inlined
def aligned(size):
    """Uninitialised float32 scratch that begins on a cache line: a vector access that straddles two
    lines costs twice."""
    scratch = np.empty(size + 15, np.float32)
    skip = (-(scratch.ctypes.data // 4)) % 16
    return scratch[skip : skip + size]


@inlined
def alive_rows(transmittance):
    """Bit y is set if a pixel of row y of the tile (flat [256]) still blends."""
    rows = 0
    for y in range(16):
        if any_lane(greater(load(transmittance, y * 16), zeros())):
            rows |= 1 << y
    return rows


@inlined
def listed_rows(item):
    """Bits first row ... last row of a list item."""
    return ((2 << ((item >> 4) & 15)) - 1) & ~((1 << (item & 15)) - 1)


@inlined
def clear_outside(transmittance, x, y, width, height):
    """T = 1 in the image, 0 (finished) for the lanes and rows of the tile outside it."""
    for j in range(16):
        for i in range(16):
            inside = x + i < width and y + j < height
            transmittance[j * 16 + i] = ONE if inside else ZERO


@inlined
def read_row(plane, at, count, buffer, place):
    """Copy `count` of 16 values of a flat image into a flat tile buffer, zeros for the rest."""
    if count == 16:
        store(buffer, place, load(plane, at))
    else:
        for i in range(16):
            buffer[place + i] = plane[at + i] if i < count else ZERO


@inlined
def write_row(plane, at, count, value, scratch):
    """Write the first `count` lanes into a flat image."""
    if count == 16:
        store(plane, at, value)
    else:
        store(scratch, 0, value)
        for i in range(count):
            plane[at + i] = scratch[i]


@inlined
def seen_from(rows, g, x, y):
    """A Gaussian as the rows of the tile at (x, y) see it: dx of their lanes, dy of the first row,
    and the four coefficients of `log_alpha`."""
    dx = iota() + splat(f4(x) + HALF - rows[g, 0])
    dy0 = splat(f4(y) + HALF - rows[g, 1])
    return dx, dy0, splat(rows[g, 2]) * dx, splat(rows[g, 3]), splat(rows[g, 4]), splat(rows[g, 5])


@inlined
def run_of(rows, g):
    """How alpha changes from row to row: (factor of its factor, longest run, B / C)."""
    return splat(rows[g, 13]), int(rows[g, 14]), splat(rows[g, 15])


@inlined
def next_run(todo, longest):
    """Split off the first consecutive rows of `todo`, at most `longest`: (first, count, the
    other rows).
    """
    first = lowest_bit(todo)
    count = min(lowest_bit(~(todo >> first)), longest)
    return first, count, todo & ~(((1 << count) - 1) << first)


@inlined
def first_alphas(placed, lean, row, count):
    """Compute alpha in a row of the tile, and the factor to alpha in the row below.

    log2(alpha) is a parabola in dy. From row to row the logarithm of the factor decreases by a
    constant, so two multiplications replace an exponential. Lanes that stay below 1/255 in all
    `count` rows get 0. In the others neither value falls below 2^-125 if count is at most
    `longest_run`; below it, `exp2` ends and slow denormals begin.

    Args:
        lean: B / C.
    """
    dx, dy0, slant, shear, fall, peak = placed
    dy = dy0 + splat(f4(row))
    summit = minimum(maximum(neg(lean * dx), dy), dy + splat(f4(count - 1)))
    seen = greater(log_alpha(dx, summit, slant, shear, fall, peak), splat(_FAINT))
    alpha = exp2(log_alpha(dx, dy, slant, shear, fall, peak))
    ratio = exp2(fma(shear, dx, fma(fall + fall, dy, fall)))
    return select(seen, alpha, zeros()), select(seen, ratio, zeros())


@inlined
def log_alpha(dx, dy, slant, shear, fall, peak):
    """log2(alpha) at (dx, dy) from the mean."""
    return fma(fma(shear, dy, slant), dx, fma(fall * dy, dy, peak))


@inlined
def longest_run(fall, peak):
    """Compute how many rows may follow `first_alphas`, as float32 vectors.

    Let d = sqrt(-fall), and p the peak, or 0 if the peak is positive. A parabola below p that
    reaches -9 in one of n rows is above p - (sqrt(9 + p) + n d)^2 in all of them and in the row
    below. This must stay above -124. It allows at least 5 rows where p = 0 and the dilation is 0.3
    pixels^2, and 2 rows at the least dilation of a coarse image, 1/12.
    """
    p = maximum(peak, zeros())
    span = math.sqrt(_LOWEST + p) - math.sqrt(p - _FAINT)
    return maximum(floor(minimum(span / math.sqrt(-fall), splat(f4(16)))), splat(ONE))


@inlined
def colour(rows, g):
    return splat(rows[g, 6]), splat(rows[g, 7]), splat(rows[g, 8])


@inlined
def blend_row(t, raw, limits):
    """Composite a Gaussian of alpha `raw` into a pixel of transmittance t.

    Args:
        limits: least alpha, least t, most alpha.

    Returns:
        Alpha after its limit, the weight, whether it blends, the pixel's next t.
    """
    least, stop, most = limits
    active = greater_equal(raw, least)
    a = minimum(raw, most)
    goes_on = both(active, greater_equal(fnma(t, a, t), stop))  # false if t < 0
    weight = select(goes_on, a * t, zeros())
    kept = t - weight
    return a, weight, goes_on, select(but_not(active, goes_on), neg(absolute(kept)), kept)


@inlined
def blend_limits():
    """Broadcast: the least alpha that blends, the least transmittance, the most alpha."""
    return splat(_MIN), splat(_STOP), splat(_MAX)
