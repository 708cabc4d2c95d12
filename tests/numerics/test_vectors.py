"""Kernels use the widest vectors of the CPU, unless the user says otherwise."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.codegen import get_host_cpu_features

from framework.command.config.schema import ROOT

# matching costs of stereo on noise: loops that LLVM vectorises by itself
COSTS = """
import hashlib
import numpy as np
from framework.depth.matching.match import match_costs

rng = np.random.default_rng(0)
height, width, planes, radius = 21, 53, 3, 2
image, mean, inverse, other = rng.random((4, height, width), np.float32)
padded = np.pad(image, ((0, 0), (radius, radius)), mode="edge")
cost = np.empty((height, planes, width), np.int16)
match_costs(
    0, 1, padded, mean, inverse, other.ravel(), np.array([[0, height, width]]),
    np.eye(3, dtype=np.float32)[None], np.array([[1.5, 0.25, 0.0]], np.float32),
    np.linspace(1, 2, planes).astype(np.float32), radius, 1, cost,
)
print(len(np.unique(cost)), hashlib.sha256(cost.tobytes()).hexdigest())
"""


def _printed(code: str, **variables: str) -> str:
    ours = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**ours, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_bits_do_not_depend_on_the_width(tmp_path: Path) -> None:
    host = get_host_cpu_features()
    if "+avx512f" not in host.split(","):
        pytest.skip("this CPU has no vectors of 512 bits")
    actual = {
        _printed(COSTS, NUMBA_CPU_FEATURES=features, NUMBA_CACHE_DIR=str(tmp_path / str(i)))
        for i, features in enumerate((host, f"{host},-prefer-256-bit"))
    }
    assert len(actual) == 1 and int(actual.pop().split()[0]) > 100
