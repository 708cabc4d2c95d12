"""Imports without the garbage collector.

An import makes hundreds of thousands of objects that live to the end. Scanning them again and again
while they are made takes 0.2 s with torch and numba.
"""

from __future__ import annotations

import gc
import importlib
import sys


def import_uncollected(module: str) -> None:
    """Import `module` with the collector off, and exempt all that lives then from later ones. Does
    nothing the second time, so that a study of many runs exempts little of their garbage."""
    if module in sys.modules:
        return
    enabled = gc.isenabled()
    gc.disable()
    try:
        importlib.import_module(module)
        gc.freeze()
    finally:
        if enabled:
            gc.enable()
