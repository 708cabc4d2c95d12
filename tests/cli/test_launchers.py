"""A launcher starts fresh processes: registry, folder names and failures must reach them."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.compute.jit import KERNEL_CACHE


def test_workers_end_with_the_command_that_started_them(tmp_path: Path) -> None:
    """Killed, so no process can report them."""
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="no joblib launcher here")
    line = "hydra/launcher=joblib hydra.launcher.n_jobs=2 trainer.steps=100000 seed=0,1"
    line += " scene.width=64 scene.height=48 scene.supersampling=1"
    with subprocess.Popen(
        [sys.executable, str(ROOT / "run.py"), *line.split(), "-m"],
        cwd=tmp_path,
        env={
            **os.environ,
            "FISHERSPLAT_CACHE": str(tmp_path / "cache"),
            "NUMBA_CACHE_DIR": str(KERNEL_CACHE),  # compiled kernels of other tests
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as command:
        try:
            _wait_for(lambda: len(_workers(tmp_path)) == 2)
            workers = _workers(tmp_path)
            assert command.pid not in workers
        finally:
            command.send_signal(signal.SIGKILL)
    try:
        _wait_for(lambda: not any(map(_alive, workers)))
    finally:
        for pid in filter(_alive, workers):
            os.kill(pid, signal.SIGKILL)


def _workers(folder: Path) -> list[int]:
    """The processes that are at a run; a lock is signed just after it was made."""
    texts = [path.read_text() for path in (folder / "reports").glob("*/runs/*/.lock.holder")]
    return [int(json.loads(text)["pid"]) for text in texts if text]


def _alive(pid: int) -> bool:
    """Not ended, nor waiting for its parent to notice that it has."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"


def _wait_for(condition: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
