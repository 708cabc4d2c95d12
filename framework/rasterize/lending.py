"""Memory for what a step makes and drops, as images and gradients, lent again instead of allocated.

Every 4 KB of new memory are a page fault, which takes longer than computing what goes there; what
that cost is in benchmarks/results/step.md.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np

LINE = 64  # bytes that a processor loads at once
_FLOATS = LINE // 4
_KEPT = 4  # buffers at most
_UNSHARED = 2  # references to memory that nobody holds: of the kept view, and of an argument


def aligned(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Uninitialised and on a cache line, as `np.empty` is not: a row of 16 floats that lies across
    two lines is prefetched by halves and loaded twice."""
    count = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.empty(count + LINE, np.uint8)
    skip = -buffer.ctypes.data % LINE
    return buffer[skip : skip + count].view(dtype).reshape(shape)


def grown(buffer: np.ndarray, n: int) -> np.ndarray:
    """The buffer itself, or one of at least n rows in its place."""
    return buffer if len(buffer) >= n else aligned((n + n // 4, *buffer.shape[1:]), buffer.dtype)


class Lender:
    """Lends arrays. Those of one call share a buffer, which is lent again once nobody holds any of
    them, nor a view or a tensor of one; nobody has to give anything back. For one thread."""

    def __init__(self) -> None:
        self._buffers: list[np.ndarray] = []

    def lend(self, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        """Uninitialised float32 arrays of these shapes, each on a cache line."""
        ends = list(accumulate(-(-math.prod(shape) // _FLOATS) * _FLOATS for shape in shapes))
        place = self._free()
        flat = self._buffers[place] = grown(self._buffers[place], ends[-1])
        starts = [0, *ends[:-1]]
        return [
            flat[start : start + math.prod(shape)].reshape(shape)
            for start, shape in zip(starts, shapes, strict=True)
        ]

    def _free(self) -> int:
        """The place of a buffer that nobody holds; of a new one if there is none."""
        for place in range(len(self._buffers)):
            if sys.getrefcount(self._buffers[place].base) == _UNSHARED:
                return place
        self._buffers = [*self._buffers[-_KEPT + 1 :], aligned((0,), np.float32)]
        return len(self._buffers) - 1
