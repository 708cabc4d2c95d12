"""Sixteen Gaussians at a time: their parameters to vectors, one lane each, and back.

`base` is the first Gaussian, `count` how many of the sixteen exist; fewer go through `scratch`
(flat float32, at least 64 long), whose other lanes hold anything. Arrays are flat float32.
"""

from __future__ import annotations

from typing import Any

from framework.compute.jit import inlined, kernel
from framework.compute.simd import (
    LANES,
    load,
    load2,
    load3,
    load4,
    store,
    store2,
    store3,
    store4,
)


@kernel
def _copy(source: Any, at: int, target: Any, place: int, n: int) -> None:
    for i in range(n):
        target[place + i] = source[at + i]


@inlined
def span(n: int, block: int, blocks: int) -> tuple[int, int]:
    """Which of n Gaussians a block has: whole chunks, as a vector that does not begin on a cache
    line is loaded in two halves."""
    chunks = (n + LANES - 1) // LANES
    return chunks * block // blocks * LANES, min(n, chunks * (block + 1) // blocks * LANES)


@inlined
def take1(flat: Any, base: int, count: int, scratch: Any) -> Any:
    """A vector of one number per Gaussian."""
    if count == LANES:
        return load(flat, base)
    _copy(flat, base, scratch, 0, count)
    return load(scratch, 0)


@inlined
def take2(flat: Any, base: int, count: int, scratch: Any) -> Any:
    """The two numbers per Gaussian, as a tuple of vectors."""
    if count == LANES:
        return load2(flat, 2 * base)
    _copy(flat, 2 * base, scratch, 0, 2 * count)
    return load2(scratch, 0)


@inlined
def take3(flat: Any, base: int, count: int, scratch: Any) -> Any:
    """The three numbers per Gaussian, as a tuple of vectors."""
    if count == LANES:
        return load3(flat, 3 * base)
    _copy(flat, 3 * base, scratch, 0, 3 * count)
    return load3(scratch, 0)


@inlined
def take4(flat: Any, base: int, count: int, scratch: Any) -> Any:
    """The four numbers per Gaussian, as a tuple of vectors."""
    if count == LANES:
        return load4(flat, 4 * base)
    _copy(flat, 4 * base, scratch, 0, 4 * count)
    return load4(scratch, 0)


@inlined
def put1(flat: Any, base: int, count: int, scratch: Any, value: Any) -> None:
    """Write one number per Gaussian."""
    if count == LANES:
        store(flat, base, value)
    else:
        store(scratch, 0, value)
        _copy(scratch, 0, flat, base, count)


@inlined
def put2(flat: Any, base: int, count: int, scratch: Any, values: Any) -> None:
    """Write two numbers per Gaussian, a tuple of vectors."""
    if count == LANES:
        store2(flat, 2 * base, values)
    else:
        store2(scratch, 0, values)
        _copy(scratch, 0, flat, 2 * base, 2 * count)


@inlined
def put3(flat: Any, base: int, count: int, scratch: Any, values: Any) -> None:
    """Write three numbers per Gaussian, a tuple of vectors."""
    if count == LANES:
        store3(flat, 3 * base, values)
    else:
        store3(scratch, 0, values)
        _copy(scratch, 0, flat, 3 * base, 3 * count)


@inlined
def put4(flat: Any, base: int, count: int, scratch: Any, values: Any) -> None:
    """Write four numbers per Gaussian, a tuple of vectors."""
    if count == LANES:
        store4(flat, 4 * base, values)
    else:
        store4(scratch, 0, values)
        _copy(scratch, 0, flat, 4 * base, 4 * count)
