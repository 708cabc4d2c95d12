"""Every launcher leaves the same bytes, also when a worker or the command is killed halfway."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from benchmarks.studies import digests, leftovers
from framework.command.config.schema import ROOT

pytestmark = pytest.mark.slow

RUNS = 12
STUDY = [
    *("-m", "study=far", "threads=1", "depth=ground_truth", "init.budget=300"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1", "trainer.evaluations=1"),
    *("trainer.steps=12", "metrics.lpips_weights=none", f"seed=range({RUNS})"),
]
LAUNCHERS = {
    "joblib": ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"],
    "ray": ["hydra/launcher=ray", "+hydra.launcher.ray.init.num_cpus=2"],
    "submitit": ["hydra/launcher=submitit_local", "hydra.launcher.n_jobs=2"],
}


def begin(folder: Path, words: list[str]) -> subprocess.Popen[bytes]:
    with (folder / "log.txt").open("ab") as log:
        command = [sys.executable, str(ROOT / "run.py"), *STUDY, *words]
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=log)


def check(folder: Path, words: list[str], expected: dict[str, str]) -> None:
    """The command ends well, and its study is the expected one."""
    assert begin(folder, words).wait() == 0, (folder / "log.txt").read_text()
    study = folder / "reports" / "far"
    assert len(list(study.glob("runs/*/record.json"))) == RUNS
    assert digests(study) == expected
    assert leftovers(study) == []


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What one process without a launcher leaves."""
    folder = tmp_path_factory.mktemp("one-process")
    assert begin(folder, []).wait() == 0
    return digests(folder / "reports" / "far")


@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_launcher_writes_the_same_bytes(
    launcher: str, tmp_path: Path, expected: dict[str, str]
) -> None:
    check(tmp_path, LAUNCHERS[launcher], expected)


@pytest.mark.parametrize("victim", ["worker", "command"])
@pytest.mark.parametrize("launcher", ["ray", "submitit"])
def test_launcher_is_killed_and_begun_again(
    launcher: str, victim: str, tmp_path: Path, expected: dict[str, str]
) -> None:
    words = LAUNCHERS[launcher]
    process, study = begin(tmp_path, words), tmp_path / "reports" / "far"
    while len(list(study.glob("runs/*/record.json"))) < RUNS // 3:
        assert process.poll() is None, "ended before it was killed"
        time.sleep(0.05)
    os.kill(process.pid if victim == "command" else holder(study), signal.SIGKILL)
    process.wait()
    time.sleep(3)  # until the workers notice that the command is gone
    check(tmp_path, words, expected)


def holder(study: Path) -> int:
    """Id of a process that is at a run."""
    while True:
        for path in study.glob("runs/*/.lock"):
            try:
                return int(json.loads(path.read_text())["pid"])
            except (OSError, ValueError):
                continue
        time.sleep(0.01)
