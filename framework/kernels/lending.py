"""Reusable memory for the temporary arrays of a step, such as images and gradients.

Every 4 KB of new memory cause a page fault, which takes longer than computing the content;
benchmarks/results/step.md has the measurements.
"""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Sequence
from itertools import accumulate
from typing import Any

import numpy as np

LINE = 64  # bytes that a processor loads at once
_FLOATS = LINE // 4
_KEPT = 4  # buffers at most


def aligned(shape: tuple[int, ...], dtype: Any = np.float32) -> np.ndarray:
    """Uninitialised and on a cache line, as `np.empty` is not: a row of 16 floats that lies across
    two lines is prefetched by halves and loaded twice."""
    count = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.empty(count + LINE, np.uint8)
    skip = -buffer.ctypes.data % LINE
    return buffer[skip : skip + count].view(dtype).reshape(shape)


def grown(buffer: np.ndarray, n: int) -> np.ndarray:
    """The buffer itself, or one of at least n rows in its place."""
    return buffer if len(buffer) >= n else aligned((n + n // 4, *buffer.shape[1:]), buffer.dtype)


class _Buffer:
    """Memory and the arrays in it, which are kept as long as their shapes stay the same."""

    def __init__(self) -> None:
        self._flat = aligned((0,))
        self._shapes: list[tuple[int, ...]] = []
        self._arrays: list[np.ndarray] = []
        self._unheld = self._references()

    def _references(self) -> list[int]:
        """Count the references to each array (held by tensors) and to the memory (held by
        views).
        """
        return [sys.getrefcount(array) for array in (*self._arrays, self._flat.base)]

    def free(self) -> bool:
        """Whether no array of the buffer, and no view or tensor of one, is referenced."""
        return self._references() == self._unheld

    def arrays(self, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        """Arrays of these shapes, each aligned to a cache line."""
        if self._shapes != shapes:
            ends = list(accumulate(-(-math.prod(shape) // _FLOATS) * _FLOATS for shape in shapes))
            self._flat, self._shapes = grown(self._flat, ends[-1]), list(shapes)
            self._arrays = [
                self._flat[start : start + math.prod(shape)].reshape(shape)
                for start, shape in zip([0, *ends[:-1]], shapes, strict=True)
            ]
            self._unheld = self._references()
        return self._arrays.copy()


class Lender:
    """Lends arrays and reuses them; for one thread.

    The arrays of one call share a buffer. It is lent again once none of them, and no view or tensor
    of one, is referenced, so nothing has to be returned explicitly.
    """

    def __init__(self) -> None:
        self._buffers: list[_Buffer] = []

    def lend(self, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        """Uninitialised float32 arrays of these shapes, each on a cache line."""
        for buffer in self._buffers:
            if buffer.free():
                return buffer.arrays(shapes)
        self._buffers = [*self._buffers[-_KEPT + 1 :], _Buffer()]
        return self._buffers[-1].arrays(shapes)


class ThreadsLender(threading.local):
    """A lender for callers without a workspace. Every thread has its own, because trainings may
    run at the same time.
    """

    def __init__(self) -> None:
        self._own = Lender()

    def lend(self, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        """As `Lender.lend`."""
        return self._own.lend(shapes)
