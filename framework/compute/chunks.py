"""Sixteen Gaussians at a time: their parameters to vectors, one lane each, and back.

`base` is the first Gaussian, `count` how many of the sixteen exist. Fewer go through `scratch`
(flat float32, 16 elements for each number of a Gaussian), whose other lanes hold anything. Arrays
are flat float32.
"""

from typing import Any

from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    load,
    load2,
    load3,
    load4,
    load16,
    store,
    store2,
    store3,
    store4,
    store16,
)


@kernel
def _copy(source, at, target, place, n):
    for i in range(n):
        target[place + i] = source[at + i]


@inlined
def span(n, block, blocks):
    """Which of n Gaussians a block has: whole chunks, as a vector that does not begin on a cache
    line is loaded in two halves."""
    chunks = (n + LANES - 1) // LANES
    return chunks * block // blocks * LANES, min(n, chunks * (block + 1) // blocks * LANES)


def _take(width: int, load_items: Any) -> Any:
    """Loads `width` numbers per Gaussian, as a tuple of vectors; one number as a vector."""

    @inlined
    def take(flat, base, count, scratch):
        if count == LANES:
            return load_items(flat, width * base)
        _copy(flat, width * base, scratch, 0, width * count)
        return load_items(scratch, 0)

    return take


def _put(width: int, store_items: Any) -> Any:
    """The inverse of `_take`."""

    @inlined
    def put(flat, base, count, scratch, values):
        if count == LANES:
            store_items(flat, width * base, values)
        else:
            store_items(scratch, 0, values)
            _copy(scratch, 0, flat, width * base, width * count)

    return put


take1, take2, take3, take4 = map(_take, (1, 2, 3, 4), (load, load2, load3, load4))
put1, put2, put3, put4 = map(_put, (1, 2, 3, 4), (store, store2, store3, store4))
take_row, put_row = _take(LANES, load16), _put(LANES, store16)
