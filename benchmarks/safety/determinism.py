"""Hashes of what every stage of `stages.py` computes, on this or a simulated processor.

The simulation makes the libraries and the C library leave out instructions that older processors
lack. `tests/golden/bits.json` has the hashes that the tests expect. After a change that is meant to
change numbers:

    python benchmarks/safety/determinism.py --update

LPIPS and reports are not among them, as PyTorch's convolutions are other code on each processor.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
STAGES = Path(__file__).with_name("stages.py")
BITS = ROOT / "tests" / "golden" / "bits.json"
LIBRARIES = ("numpy", "scipy", "torch", "numba", "llvmlite", "opencv-contrib-python-headless")
LIBRARIES += ("pillow", "scikit-image", "pandas")
FOLLOWING = ("metric lpips", "report")  # stages whose bits are not in the one hash

_AVX512 = "-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ"
AVX2 = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Haswell",
    "ATEN_CPU_CAPABILITY": "avx2",
    "MKL_ENABLE_INSTRUCTIONS": "AVX2",
    "MKL_CBWR": "AVX2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "OPENCV_CPU_DISABLE": "AVX512-SKX",
    "OPENCV_IPP": "avx2",
    "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_AVX512}",
}
SSE = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL",
    "OPENBLAS_CORETYPE": "Nehalem",
    "ATEN_CPU_CAPABILITY": "default",
    "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
    "MKL_CBWR": "COMPATIBLE",  # the switch above changed nothing on an AMD
    "ONEDNN_MAX_CPU_ISA": "SSE41",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FMA3,AVX,FP16",
    "OPENCV_IPP": "sse42",
    "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={_AVX512},-AVX2,-FMA,-FMA4,-AVX,-BMI2,-SSE4_1",
    "JSIMD_FORCENONE": "1",
}


def stages(
    changes: dict[str, str], kernels: str | None = None, names: Sequence[str] = ()
) -> dict[str, str]:
    """Return stage -> hash, computed with these `changes` of the environment.

    Generated scenes are not taken from a cache. Kernels are, as their cache distinguishes
    processors.
    names: stages of `stages.py`; by default the usual ones.
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "FISHERSPLAT_CACHE": cache, **changes}
        environment["NUMBA_CACHE_DIR"] = kernels or _kernel_cache()
        command = [sys.executable, str(STAGES), *names]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{command}: {done.stderr[-2000:]}")
    found: dict[str, str] = json.loads(done.stdout)
    return found


def _kernel_cache() -> str:
    code = "from framework.compute.jit import KERNEL_CACHE; print(KERNEL_CACHE)"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout[:-1]


def committed(found: dict[str, str]) -> dict[str, str]:
    """The stages that the one hash covers."""
    return {stage: bits for stage, bits in found.items() if not stage.startswith(FOLLOWING)}


def one_hash(found: dict[str, str]) -> str:
    """The one hash of all committed stages."""
    return hashlib.sha256(json.dumps(committed(found), sort_keys=True).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Versions of the libraries that compute."""
    return {name: importlib.metadata.version(name) for name in LIBRARIES}


def update() -> None:
    """Make what this checkout computes the bits that the suite expects."""
    found = committed(stages({}))
    content = {"versions": versions(), "stages": found}
    BITS.write_text(json.dumps(content, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    print(f"{BITS.relative_to(ROOT)}: {one_hash(found)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--update", action="store_true", required=True)
    parser.parse_args()
    update()


if __name__ == "__main__":
    main()
