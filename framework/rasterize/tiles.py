"""What the passes over a tile's list share: rows, masks, and how a pixel meets a Gaussian.

A tile is 16 rows of 16 lanes; per row the state is the transmittance T and what else a pass keeps.
A finished pixel keeps its T with a minus sign, so that it blends nothing more. The loops
over rows have no branch, only masks; they visit the rows that an item reaches and that were not
finished at the last look.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from framework.jit import inlined
from framework.rasterize.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from framework.rasterize.simd import (
    any_lane,
    both,
    but_not,
    exp2,
    fma,
    fnma,
    greater,
    greater_equal,
    iota,
    load,
    minimum,
    neg,
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
CHECK = 16  # items between two looks at which rows are finished
AHEAD = 6  # items between asking for a Gaussian's row and using it


@inlined
def aligned(size: int) -> Any:
    """Uninitialised float32 scratch that begins on a cache line: a vector access that straddles two
    lines costs twice."""
    scratch = np.empty(size + 15, np.float32)
    skip = (-(scratch.ctypes.data // 4)) % 16
    return scratch[skip : skip + size]


@inlined
def row_numbers() -> Any:
    """[256], the row of every pixel of a tile."""
    numbers = np.empty(256, np.float32)
    for i in range(256):
        numbers[i] = f4(i // 16)
    return numbers


@inlined
def alive_rows(transmittance: Any) -> int:
    """Bit y is set if a pixel of row y of the tile (flat [256]) still blends."""
    rows = 0
    for y in range(16):
        if any_lane(greater(load(transmittance, y * 16), zeros())):
            rows |= 1 << y
    return rows


@inlined
def listed_rows(item: Any) -> int:
    """Bits first row ... last row of a list item."""
    return ((2 << ((item >> 4) & 15)) - 1) & ~((1 << (item & 15)) - 1)


@inlined
def clear_outside(transmittance: Any, x: int, y: int, width: int, height: int) -> None:
    """T = 1 in the image, 0 (finished) for the lanes and rows of the tile outside it."""
    for j in range(16):
        for i in range(16):
            inside = x + i < width and y + j < height
            transmittance[j * 16 + i] = ONE if inside else ZERO


@inlined
def read_row(plane: Any, at: int, count: int, buffer: Any, place: int) -> None:
    """Copy `count` of 16 values of a flat image into a flat tile buffer, zeros for the rest."""
    if count == 16:
        store(buffer, place, load(plane, at))
    else:
        for i in range(16):
            buffer[place + i] = plane[at + i] if i < count else ZERO


@inlined
def write_row(plane: Any, at: int, count: int, value: Any, scratch: Any) -> None:
    """Write the first `count` lanes into a flat image."""
    if count == 16:
        store(plane, at, value)
    else:
        store(scratch, 0, value)
        for i in range(count):
            plane[at + i] = scratch[i]


@inlined
def seen_from(rows: Any, g: int, x: int, y: int) -> tuple[Any, Any, Any, Any, Any, Any]:
    """A Gaussian as the rows of the tile at (x, y) see it: dx of their lanes, dy of the first row,
    and the four coefficients of `log_alpha`."""
    dx = iota() + splat(f4(x) + HALF - rows[g, 0])
    dy0 = splat(f4(y) + HALF - rows[g, 1])
    return dx, dy0, splat(rows[g, 2]) * dx, splat(rows[g, 3]), splat(rows[g, 4]), splat(rows[g, 5])


@inlined
def log_alpha(dx: Any, dy: Any, slant: Any, shear: Any, fall: Any, peak: Any) -> Any:
    """log2(alpha) at (dx, dy) from the mean."""
    return fma(fma(shear, dy, slant), dx, fma(fall * dy, dy, peak))


@inlined
def colour(rows: Any, g: int) -> tuple[Any, Any, Any]:
    return splat(rows[g, 6]), splat(rows[g, 7]), splat(rows[g, 8])


@inlined
def meet(t: Any, power: Any, limits: Any) -> tuple[Any, ...]:
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


@inlined
def blend_limits() -> tuple[Any, Any, Any]:
    """Broadcast: log2 of the least alpha that blends, the least transmittance, the most alpha."""
    return splat(_CUT), splat(_STOP), splat(_MAX)
