"""Hashes of what every stage of `stages.py` computes, on this or a simulated older processor.

Environment variables keep the libraries and the C library from using newer instructions.
`tests/golden/bits.json` has the hashes that the tests expect. After an intentional change of
numbers:

    python benchmarks/safety/determinism.py --update

LPIPS is not included, because PyTorch's convolutions differ between processors.
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
    """Compute the hash of each stage in an environment with these `changes`.

    Only kernels come from a cache, which is separate for each processor. names: stages of
    `stages.py`; none for the usual ones.
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "FISHERSPLAT_CACHE": cache, **changes}
        environment["NUMBA_CACHE_DIR"] = kernels or _kernel_cache()
        command = [sys.executable, str(STAGES), *names]
        done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{command}: {done.stderr[-2000:]}")
    hashes: dict[str, str] = json.loads(done.stdout)
    return hashes


def _kernel_cache() -> str:
    code = "from framework.compute.jit import KERNEL_CACHE; print(KERNEL_CACHE)"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, check=True, cwd=ROOT, capture_output=True, text=True).stdout[:-1]


def one_hash(hashes: dict[str, str]) -> str:
    """Return one hash of all stages."""
    return hashlib.sha256(json.dumps(hashes, sort_keys=True).encode()).hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of the numerical libraries."""
    return {name: importlib.metadata.version(name) for name in LIBRARIES}


def update() -> None:
    """Make what this checkout computes the bits that the suite expects."""
    hashes = stages({})
    content = {"versions": versions(), "stages": hashes}
    BITS.write_text(json.dumps(content, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    print(f"{BITS.relative_to(ROOT)}: {one_hash(hashes)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--update", action="store_true", required=True)
    parser.parse_args()
    update()


if __name__ == "__main__":
    main()
