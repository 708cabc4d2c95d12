"""The same seed gives the same bits with any number of threads, launcher and processor."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.safety.determinism import AVX2, SSE, stages
from framework.command.config.schema import ROOT

pytestmark = pytest.mark.slow

RUN = ["augment=safi", "reg=uar", "trainer.steps=100", "metrics.lpips_weights=none"]
PROCESSORS = {
    "libraries with AVX2": AVX2,
    "Haswell": {**AVX2, "NUMBA_CPU_NAME": "haswell"},
    "Nehalem": {**SSE, "NUMBA_CPU_NAME": "nehalem"},
}


def parameters(words: list[str], cache: Path, record: Path) -> str:
    """SHA-256 of the Gaussians that `run.py` with these words trains."""
    environment = {**os.environ, "FISHERSPLAT_CACHE": str(cache)}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, str(ROOT / "run.py"), *RUN, *words]
    subprocess.run(command, check=True, cwd=ROOT, env=environment, capture_output=True)
    return str(json.loads(record.read_text("utf-8"))["parameters_sha256"])


def test_threads_kernel_cache_and_launcher_change_no_bit(tmp_path: Path) -> None:
    """The first run compiles the kernels, the others take them from the cache."""
    cache, hashes = tmp_path / "cache", set()
    for threads in (1, 1, 2, 3):
        folder = tmp_path / f"run-{threads}"
        words = [f"threads={threads}", "force=true", f"hydra.run.dir={folder}"]
        hashes.add(parameters(words, cache, folder / "record.json"))
    sweep = tmp_path / "sweep"
    words = ["-m", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1", "threads=1"]
    words += [f"hydra.sweep.dir={sweep}", "hydra.sweep.subdir=${seed}"]
    hashes.add(parameters(words, cache, sweep / "0" / "record.json"))
    assert len(hashes) == 1


@pytest.mark.parametrize("processor", PROCESSORS)
def test_another_processor_changes_no_bit(processor: str) -> None:
    """`tests/golden/test_bits.py` has one more, on which the libraries know SSE 4.2 alone."""
    assert stages(PROCESSORS[processor]) == stages({})


def test_every_plugin_trains_the_same_on_another_processor() -> None:
    assert stages(SSE, names=("plugins",)) == stages({}, names=("plugins",))
