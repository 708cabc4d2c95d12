"""A full or read-only disk and vanished input: one line, nothing half-written, and the run can be
done when there is room again."""

import resource
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.errors import UserError
from framework.files.whole import write_whole
from framework.records.progress import Silent
from tests.cli.conftest import FakeRuns, runs
from tests.record.test_reuse import group, run_experiment, small_config

__all__ = ["runs"]


@contextmanager
def largest_file(n_bytes: int) -> Iterator[None]:
    """No file can grow beyond `n_bytes`: writes fail as they do on a full disk."""
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


def test_a_file_that_does_not_fit_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    write_whole(path, b"old")
    with largest_file(10_000), pytest.raises(UserError, match=r"a\.bin: expected room to write"):
        write_whole(path, bytes(100_000))
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"] and path.read_bytes() == b"old"


def test_a_run_on_a_full_disk_can_be_done_later(tmp_path: Path) -> None:
    config = small_config(group("depth", "ground_truth"))
    expected = run_experiment(config, tmp_path / "whole", Silent())
    with largest_file(10_000), pytest.raises(UserError, match="free some space") as caught:
        run_experiment(config, tmp_path / "run", Silent())
    assert "\n" not in str(caught.value)
    left = [path for path in (tmp_path / "run").rglob("*") if path.is_file()]
    assert not [path for path in left if path.suffix == ".tmp" or path.name == "record.json"]
    again = run_experiment(config, tmp_path / "run", Silent())
    assert again.parameters_sha256 == expected.parameters_sha256


def test_an_output_folder_that_cannot_be_written(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("file").write_text("in the way")
    for line in (["hydra.run.dir=file/x"], ["hydra.sweep.dir=file", "seed=0,1", "-m"]):
        assert main(line) == 2
        message = capsys.readouterr().err
        assert message.startswith("error: ") and message.count("\n") == 1 and "file" in message
    assert not runs.seen
