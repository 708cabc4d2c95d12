"""How kernels are compiled: strict IEEE (no `fastmath`: it changes bits between processes), without
the GIL, cached on disk.

numba's own cache notices a change of a kernel's file but not of a helper it imports from another.
So the cache is a folder of the user's cache named by a hash of all of the framework's sources that
hold kernels (`NUMBA_CACHE_DIR` overrides it). Import `kernel` before decorating anything else.

Where a CPU has AVX-512, LLVM still takes vectors of 256 bits by default, as the first such CPUs
slowed down. With all 512 the loops that it vectorises by itself take less time,
those of stereo above all; no bit depends on it.
"""

import hashlib
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.codegen import get_host_cpu_features

from framework.files.cache import cache_dir

_STRICT: dict[str, Any] = {"nogil": True, "fastmath": False, "error_model": "numpy"}


_COMPILED = re.compile(rb"^\s*(?:from|import) (?:numba|framework\.compute\.jit)\b", re.MULTILINE)


_IMPORT = re.compile(rb"^from framework([.\w]*) import (\([^)]*\)|.*)$", re.MULTILINE)
_CONSTANT = re.compile(rb"\b[A-Z][A-Z0-9_]+\b")


def _sources_hash() -> str:
    """Hash the sources that define kernels or vector operations, and numba's version.

    Sources of constants that are compiled into kernels count too.
    """
    root = Path(__file__).parents[1]
    sources = {path: path.read_bytes() for path in root.rglob("*.py")}
    compiled = {path for path, source in sources.items() if _COMPILED.search(source)}
    for path in tuple(compiled):
        for module, names in _IMPORT.findall(sources[path]):
            place = root.joinpath(*module.decode().strip(".").split("."))
            if _CONSTANT.search(names):
                compiled |= {place.with_suffix(".py"), place / "__init__.py"} & sources.keys()
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(compiled):
        digest.update(path.relative_to(root).as_posix().encode() + sources[path])
    return digest.hexdigest()[:16]


_config: Any = numba.config
if not os.environ.get("NUMBA_CACHE_DIR"):
    _config.CACHE_DIR = str(cache_dir() / "kernels" / _sources_hash())

if _config.CPU_NAME is None and _config.CPU_FEATURES is None:  # nor has the user chosen any
    _host = get_host_cpu_features()
    if "+avx512f" in _host.split(","):
        _config.CPU_FEATURES = f"{_host},-prefer-256-bit"

KERNEL_CACHE = Path(_config.CACHE_DIR)


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` as a kernel that Python calls."""
    compiled: Callable[..., Any] = numba.njit(cache=True, **_STRICT)(function)
    return compiled


def inlined(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile `function` into the kernels that call it."""
    compiled: Callable[..., Any] = numba.njit(inline="always", **_STRICT)(function)
    return compiled
