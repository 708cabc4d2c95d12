"""What the system, Hydra's grammar or the memory refuse ends in one line, never in a traceback."""

import errno
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.studies.failures import kind_of
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (OSError(errno.ENAMETOOLONG, "File name too long", "a" * 500), 2, "File name too long"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "(FISHERSPLAT_CACHE): expected room"),
        (OSError(errno.ELOOP, "Too many links", "/x"), 2, "/x: expected what may be opened"),
        (MemoryError("Unable to allocate 9 GiB"), 2, "memory: expected room for the run, got 'Una"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you"), 2, "memory: expected"),
        (ImportError("libx.so: failed to map segment from shared object"), 2, "memory: expected"),
    ],
    ids=str,
)
def test_a_run_that_the_system_ends(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], error: Exception, code: int, message: str
) -> None:
    runs.failures[0] = error
    assert main(["seed=0"]) == code
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert kind_of(error) == "machine"


def test_a_report_without_memory(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("Unable to allocate 9 GiB")

    monkeypatch.setattr("framework.report.build.build_report", fail)
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("error: memory: expected room")
