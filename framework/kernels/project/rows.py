"""Reads and writes rows of projected Gaussians; `projection` describes their 16 floats."""

from __future__ import annotations

from typing import Any

from framework.compute.jit import inlined
from framework.compute.simd import LANES, load16, store16


@inlined
def put_row(rows: Any, base: int, count: int, row: Any, spare: Any) -> None:
    """Store the rows of `count` Gaussians.

    Args:
        spare: scratch [256].
    """
    if count == LANES:
        store16(rows, base * LANES, row)
    else:
        store16(spare, 0, row)
        for i in range(count * LANES):
            rows[base * LANES + i] = spare[i]


@inlined
def take_row(rows: Any, base: int, count: int, spare: Any) -> Any:
    """What `put_row` stored; the lanes beyond are of no meaning."""
    if count == LANES:
        row = load16(rows, base * LANES)
    else:
        for i in range(count * LANES):
            spare[i] = rows[base * LANES + i]
        row = load16(spare, 0)
    return row
