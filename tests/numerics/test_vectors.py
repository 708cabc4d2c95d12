"""Kernels use the widest vectors of the CPU, unless the user says otherwise."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from numba.core.codegen import get_host_cpu_features

from framework.config import ROOT

SHOW = "from framework import jit; print(jit._config.CPU_FEATURES)"


def _features(**variables: str) -> str:
    own = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_CPU")}
    done = subprocess.run(
        [sys.executable, "-c", SHOW],
        env={**own, "PYTHONPATH": str(ROOT), **variables},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


def test_all_512_bits_where_there_are_so_many() -> None:
    host = get_host_cpu_features()
    if "+avx512f" in host.split(","):
        assert _features() == f"{host},-prefer-256-bit"
    else:
        assert _features() == "None"


@pytest.mark.parametrize("chosen", [{"NUMBA_CPU_FEATURES": "+sse2"}, {"NUMBA_CPU_NAME": "generic"}])
def test_the_user_may_choose(chosen: dict[str, str]) -> None:
    assert "prefer" not in _features(**chosen)
