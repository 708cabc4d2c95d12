"""The process beside a lone run: it makes the same report, and nothing is lost when it fails."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import framework.report
from framework import reporter
from framework.cli import main
from framework.config import ROOT
from framework.errors import UserError
from tests.cli.conftest import FakeRuns
from tests.record.fakes import fake_run


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "study"
    for seed in (0, 1):
        fake_run(folder / "runs", seed=seed)
    return folder


@pytest.fixture
def beside(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A process beside; this one may build no report."""
    monkeypatch.setattr(framework.report, "build_report", _refuse)
    with reporter.ended():
        reporter.start()
        assert reporter._beside
        yield
    assert not reporter._beside


def _refuse(folder: Path) -> Path:
    raise UserError(f"built here: {folder.name}")


def _files(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in sorted(folder.iterdir()) if p.is_file()}


def test_its_report_is_the_one_made_without_it(study: Path) -> None:
    alone = reporter.build(study)
    expected = _files(study)
    for name in expected:
        (study / name).unlink()
    with reporter.ended():
        reporter.start()
        assert reporter.build(study) == alone
    assert len(expected) >= 4 and _files(study) == expected


def test_it_builds_and_not_this_process(beside: None, study: Path) -> None:
    assert reporter.build(study).exists()


def test_what_it_cannot_do_is_done_and_told_here(beside: None, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="built here: empty"):
        reporter.build(tmp_path / "empty")


def test_one_that_is_gone_is_done_without(beside: None, study: Path) -> None:
    reporter._beside[0].kill()
    reporter._beside[0].wait()
    with pytest.raises(UserError, match="built here: study"):
        reporter.build(study)


def test_what_others_print_is_no_answer(
    study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A library may print while it is imported, before anything can keep it from that."""
    (tmp_path / "sitecustomize.py").write_text("print('hello')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with reporter.ended():
        reporter.start()
        assert reporter.build(study) == study / "report.md"
        assert reporter._beside[0].poll() is not None  # it does not write beside us


def test_it_ends_with_the_command(tmp_path: Path) -> None:
    """Killed, that is; otherwise it would go on writing the report, without the lock. Its input is
    kept open here, as if it had no time to read that it ended."""
    code = """
import os, subprocess
from framework import reporter
reporter.start()
(process,) = reporter._beside
os.set_inheritable(process.stdin.fileno(), True)
holder = subprocess.Popen(["sleep", "60"], close_fds=False, stdout=subprocess.DEVNULL)
print(process.pid, holder.pid, flush=True)
input()
"""
    parent = subprocess.Popen(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    child, holder = map(int, parent.stdout.readline().split())
    os.kill(child, 0)
    parent.kill()
    parent.communicate()
    try:
        end = time.monotonic() + 30
        while _lives(child):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert _lives(holder)
    finally:
        os.kill(holder, 9)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{process}/stat")
    return not state.exists() or state.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_lone_core_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reporter.parallel, "threads", lambda: 1)
    reporter.start()
    assert not reporter._beside


def test_it_is_for_lone_runs(runs: FakeRuns, monkeypatch: pytest.MonkeyPatch) -> None:
    """A study keeps all cores busy by itself; and one that was refused has none to end."""
    started: list[bool] = []
    monkeypatch.setattr(reporter, "start", lambda: started.append(True))
    assert main(["seed=0,1", "-m"]) == 0
    assert started == []
    assert main(["seed=0"]) == 0
    assert started == [True]
    assert main(["trainer.steps=0"]) == 2
    assert main(["threads=1"]) == 0
    assert started == [True]
