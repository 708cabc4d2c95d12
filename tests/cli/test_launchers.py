"""A launcher starts fresh processes: registry, folder names and failures must reach them."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.compute.jit import KERNEL_CACHE
from tests.cli.test_remote_launchers import holders, wait_for


@pytest.mark.slow
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
            wait_for(lambda: len(holders(tmp_path)) == 2)
            workers = holders(tmp_path)
            assert command.pid not in workers
        finally:
            command.send_signal(signal.SIGKILL)
    try:
        wait_for(lambda: not any(map(_alive, workers)))
    finally:
        for pid in filter(_alive, workers):
            os.kill(pid, signal.SIGKILL)


def _alive(pid: int) -> bool:
    """Not ended, nor waiting for its parent to notice that it has."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
