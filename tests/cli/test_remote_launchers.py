"""Runs sent to other processes by submitit and Ray, and studies that outlive their command."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.studies import digests, leftovers
from framework.command import cli
from framework.command.config.schema import ROOT
from framework.command.launchers import manage, submission, supported
from framework.command.launchers.submission import (
    Run,
    Submission,
    new_submission,
    read_submission,
    work,
)
from framework.command.studies.study import LEDGER_VARIABLE, Outcome
from tests.cli.conftest import FakeRuns

SMALL = (
    "threads=1 depth=ground_truth init.budget=300 scene.width=64 scene.height=48"
    " scene.supersampling=1 trainer.steps=12 trainer.evaluations=1 study=far"
)
SUBMITIT = "hydra_plugins.hydra_submitit_launcher"
RAY = "hydra_plugins.hydra_ray_launcher"
LOCAL = "hydra/launcher=submitit_local hydra.launcher.n_jobs=2"
RAY_HERE = "hydra/launcher=ray +hydra.launcher.ray.init.num_cpus=2"


def command(folder: Path, line: str, **keywords: object) -> subprocess.CompletedProcess[str]:
    folder.mkdir(exist_ok=True)
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=300,
        **keywords,  # type: ignore[call-overload, no-any-return]
    )


def wait_for(condition: Callable[[], object], seconds: float = 240) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.2)


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """What one process makes of the study."""
    folder = tmp_path_factory.mktemp("here")
    done = command(folder, f"{SMALL} seed=0,1 -m")
    assert done.returncode == 0, done.stderr
    return digests(folder / "reports" / "far")


@pytest.mark.slow
def test_ray_makes_the_same_bytes(tmp_path: Path, expected: dict[str, str]) -> None:
    pytest.importorskip(RAY, reason="ray is an extra")
    done = command(tmp_path, f"{SMALL} {RAY_HERE} seed=0,1 -m")
    assert done.returncode == 0, done.stderr
    assert digests(tmp_path / "reports" / "far") == expected
    assert not leftovers(tmp_path / "reports" / "far")
    assert "2 of 2 ended" in done.stdout and done.stdout.count("report: ") == 1


@pytest.mark.slow
@pytest.mark.parametrize(("module", "words"), [(SUBMITIT, LOCAL), (RAY, RAY_HERE)])
def test_failures_elsewhere_reach_the_table(tmp_path: Path, module: str, words: str) -> None:
    pytest.importorskip(module, reason=f"{module} is an extra")
    (tmp_path / "empty").mkdir()
    done = command(
        tmp_path, f"{words} seed=0,1 scene=llff scene.path=empty depth=plane_sweep study=far -m"
    )
    assert done.returncode == 2, done.stderr
    assert "2 of 2 runs failed" in done.stderr and "Traceback" not in done.stderr
    assert "seed=1" in done.stderr and "launcher" not in done.stderr  # how to do one alone
    records = (tmp_path / "reports" / "far" / "runs").glob("*/record.json")
    assert [json.loads(path.read_text())["status"] for path in records] == ["failed", "failed"]


@pytest.mark.slow
def test_a_killed_worker_costs_no_byte(tmp_path: Path, expected: dict[str, str]) -> None:
    """Where no other worker can do its run, the same command again does it."""
    pytest.importorskip(SUBMITIT, reason="submitit is an extra")
    line = f"{SMALL} hydra/launcher=submitit_local hydra.launcher.n_jobs=1 seed=0,1 -m"
    with subprocess.Popen(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        wait_for(lambda: holders(tmp_path))
        os.kill(holders(tmp_path)[0], signal.SIGKILL)
        out, err = running.communicate(timeout=300)
    assert running.returncode == 1, err
    assert "runs ended without a result" in err and "lost: " in out
    logs = list((tmp_path / "reports" / ".submitted").glob("*/log"))
    assert len(logs) == 1, "kept where a run was lost"
    again = command(tmp_path, line)
    assert again.returncode == 0 and "2 of 2 ended" in again.stdout, again.stderr
    study = tmp_path / "reports" / "far"
    assert digests(study) == expected and not leftovers(study)


def holders(folder: Path) -> list[int]:
    """The processes that are at a run."""
    texts = [path.read_text() for path in (folder / "reports").glob("*/runs/*/.lock.holder")]
    return [int(text.split()[1]) for text in texts if text]  # "process 123 on ..."


# submissions, without processes


def outcome(number: int, folder: Path, error: str | None = None, busy: bool = False) -> Outcome:
    return Outcome(number, str(folder / "far" / "runs" / f"r{number}"), error, busy=busy)


def a_submission(folder: Path, n_runs: int = 4) -> Submission:
    runs = [(i, [f"seed={i}"]) for i in range(n_runs)]
    return new_submission(folder, "study submit seed=...", "local", runs, True)


@pytest.fixture
def reported(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """An entry for each time that the reports were built."""
    times = list[int]()
    monkeypatch.setattr(submission, "build_reports", lambda: times.append(1))
    monkeypatch.setenv(LEDGER_VARIABLE, "")
    return times


def test_workers_share_the_runs(
    tmp_path: Path, reported: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    submitted, done = a_submission(tmp_path), list[int]()

    def do(run: Run) -> Outcome:
        done.append(run[0])
        if run[0] == 1:
            work(read_submission(submitted.folder), other, 2)  # a second worker, meanwhile
        return outcome(run[0], tmp_path, "broken" if run[0] == 2 else None)

    def other(run: Run) -> Outcome:
        return outcome(1, tmp_path, "busy", True) if run[0] == 1 else do(run)

    work(submitted, do)
    assert sorted(done) == [0, 1, 2, 3] and reported == [1], "nothing lost or doubled"
    assert manage.main(["status", "--dir", str(tmp_path)], "study") == 0
    assert "all ended, 3 of 4 runs done, 1 failed, 0 left" in capsys.readouterr().out


def test_cancel_interrupts_and_forgets_nothing(
    tmp_path: Path, reported: list[int], capsys: pytest.CaptureFixture[str]
) -> None:
    submitted = a_submission(tmp_path)

    def do(run: Run) -> Outcome:
        if run[0] == 1:
            assert manage.main(["cancel", "--dir", str(tmp_path)], "study") == 0
            time.sleep(30)
        return outcome(run[0], tmp_path)

    with pytest.raises(KeyboardInterrupt):
        work(submitted, do)
    assert list(submitted.ended()) == [0]
    work(submitted, do)  # a worker that waited in the queue
    assert list(submitted.ended()) == [0] and not reported
    manage.main(["status", "--dir", str(tmp_path)], "study")
    assert "cancelled, 1 of 4 runs done" in capsys.readouterr().out


def test_submitted_polled_collected(tmp_path: Path) -> None:
    pytest.importorskip(SUBMITIT, reason="submitit is an extra")
    done = command(tmp_path, f"study submit {SMALL} hydra.launcher.n_jobs=1 seed=0")
    assert done.returncode == 0, done.stderr
    assert "of 1 runs done" in done.stdout and "report: " not in done.stdout
    again = "study submit hydra.launcher.n_jobs=1 hydra/launcher=submitit_local threads=1"
    assert f"\npython {ROOT / 'run.py'} {again}" in done.stdout
    wait_for((tmp_path / "reports" / "far" / "report.md").exists)
    message = command(tmp_path, "study status")
    assert "all ended, 1 of 1 runs done, 0 failed" in message.stdout
    collected = command(tmp_path, "study collect")
    assert collected.returncode == 0 and "report: reports/far/report.md" in collected.stdout


def test_a_missing_extra_is_named(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(supported, "_installed", lambda module: False)
    assert supported.missing_extra("ray") == "ray" and supported.missing_extra("joblib") is None
    assert cli.main(["study", "submit", "seed=0,1"]) == 2
    assert "pip install 'fishersplat[submitit]'" in capsys.readouterr().err
