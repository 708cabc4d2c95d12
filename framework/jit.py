"""How kernels are compiled: strict IEEE (no `fastmath`: it changes bits between processes), without
the GIL, cached on disk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

_STRICT: dict[str, Any] = {"nogil": True, "fastmath": False, "error_model": "numpy"}


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` as a kernel that Python calls."""
    compiled: Callable[..., Any] = njit(cache=True, **_STRICT)(function)
    return compiled


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` into the kernels that call it."""
    compiled: Callable[..., Any] = njit(inline="always", **_STRICT)(function)
    return compiled
