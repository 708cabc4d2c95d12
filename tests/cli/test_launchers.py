"""A launcher starts fresh processes: registry, folder names and failures must reach them."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from framework.config import ROOT


def test_failures_in_other_processes_reach_the_exit_code(tmp_path: Path) -> None:
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="no joblib launcher here")
    (tmp_path / "empty").mkdir()
    line = (
        "hydra/launcher=joblib +reg=uar seed=0,1 scene=llff scene.path=empty depth=plane_sweep -m"
    )
    done = subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=tmp_path,
        env={**os.environ, "FISHERSPLAT_CACHE": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1 and "2 of 2 runs failed" in errors[0]
    assert "Traceback" not in done.stderr
    records = sorted((tmp_path / "reports" / "llff_empty_3v" / "runs").glob("*/record.json"))
    assert [json.loads(path.read_text())["status"] for path in records] == ["failed", "failed"]
    assert not list((tmp_path / "cache").glob("ledger-*"))


def test_workers_end_with_the_command_that_started_them(tmp_path: Path) -> None:
    """Killed, so that nothing can tell them."""
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="no joblib launcher here")
    line = "hydra/launcher=joblib hydra.launcher.n_jobs=2 trainer.steps=100000 seed=0,1"
    with subprocess.Popen(
        [sys.executable, str(ROOT / "run.py"), *line.split(), "-m"],
        cwd=tmp_path,
        env={**os.environ, "FISHERSPLAT_CACHE": str(tmp_path / "cache")},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as command:
        locks = (tmp_path / "reports").glob
        try:
            _wait_for(lambda: len(list(locks("*/runs/*/.lock"))) == 2)
            workers = [json.loads(path.read_text())["pid"] for path in locks("*/runs/*/.lock")]
            assert command.pid not in workers
        finally:
            command.send_signal(signal.SIGKILL)
    _wait_for(lambda: not any(map(_alive, workers)))


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def _wait_for(condition: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.1)
