"""One process at a time at a run; the lock of a dead one is no lock."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.config.schema import ROOT
from framework.files.locks import LOCK, Busy, locked, remove_stale
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]

HOLD = (
    "import sys, time; from pathlib import Path; from framework.files.locks import locked\n"
    "with locked(Path(sys.argv[1])): print('held', flush=True); time.sleep(60)"
)


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lock of `tmp_path/run`."""
    command = [sys.executable, "-c", HOLD, str(tmp_path / "run")]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.wait()


def test_a_second_process_is_told_who_is_at_it(
    holder: subprocess.Popen[str], tmp_path: Path
) -> None:
    expected = rf"run: expected no other process.*process {holder.pid} on "
    with pytest.raises(Busy, match=expected), locked(tmp_path / "run"):
        raise AssertionError("both hold the lock")
    assert (tmp_path / "run" / LOCK).exists()


def test_the_lock_of_a_killed_process_is_free(
    holder: subprocess.Popen[str], tmp_path: Path
) -> None:
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert (tmp_path / "run" / LOCK).exists()
    with locked(tmp_path / "run"):
        pass
    assert not (tmp_path / "run" / LOCK).exists()


def test_only_a_stale_lock_is_removed(holder: subprocess.Popen[str], tmp_path: Path) -> None:
    """Leftovers next to it belong to another process while the lock is held."""
    left = tmp_path / "run" / "left"
    left.touch()

    def also(folder: Path) -> None:
        (folder / left.name).unlink()

    remove_stale(tmp_path / "run", also)
    assert (tmp_path / "run" / LOCK).exists() and left.exists()
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    remove_stale(tmp_path / "run", also)
    remove_stale(tmp_path / "run", also)
    assert not (tmp_path / "run" / LOCK).exists() and not left.exists()


def test_runs_done_elsewhere_are_no_failures(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.failures[1] = Busy("reports/x: expected no other process at this run, got process 7")
    assert main(["seed=0,1,2", "-m"]) == 3
    message = capsys.readouterr()
    assert message.err.startswith("error: another process does 1 of 3 runs, for instance reports/x")
    assert message.err.count("\n") == 1
    assert "report: reports/embedded/report.md" in message.out
    assert not (runs.folders[1] / "failed.json").exists()
    assert main(["seed=1"]) == 3
