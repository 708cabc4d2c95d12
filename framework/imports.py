"""Imports: what they make is kept from the garbage collector, what they read is read beside.

An import makes hundreds of thousands of objects that live to the end; looking through them again
and again while they are made takes 0.2 s with torch and numba, freeing them at the end 0.7 s
(`run.py` freezes them too).
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import importlib.util
import sys
import threading
from pathlib import Path

TORCH_LIBRARY = "lib/libtorch_cpu.so"


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


def import_trainer() -> None:
    """Import what a run needs. Meanwhile a thread loads torch's largest library, which takes 0.3 s
    and, unlike an import, leaves the interpreter free."""
    if "framework.experiment" in sys.modules:
        return
    library = threading.Thread(target=_load_torch)
    library.start()
    import_uncollected("numba")
    library.join()
    import_uncollected("framework.experiment")


def _load_torch() -> None:
    """Does nothing where there is no such file; torch's import tells."""
    spec = importlib.util.find_spec("torch")
    if spec is not None and spec.origin is not None:
        with contextlib.suppress(OSError):
            ctypes.CDLL(str(Path(spec.origin).parent / TORCH_LIBRARY))
