"""Uninitialised arrays that begin on a cache line.

Those of `np.empty` may not: a row of 16 floats that lies across two lines is prefetched by halves
and loaded twice.
"""

import math
from typing import Any

import numpy as np

LINE = 64  # bytes that a processor loads at once


def aligned(shape: tuple[int, ...], dtype: Any = np.float32) -> np.ndarray:
    """An array of this shape."""
    count = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.empty(count + LINE, np.uint8)
    skip = -buffer.ctypes.data % LINE
    return buffer[skip : skip + count].view(dtype).reshape(shape)


def grown(buffer: np.ndarray, n: int) -> np.ndarray:
    """The buffer itself, or one of at least n rows in its place."""
    return buffer if len(buffer) >= n else aligned((n + n // 4, *buffer.shape[1:]), buffer.dtype)
