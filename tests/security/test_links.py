"""Links and pipes where the program writes: nothing elsewhere is overwritten, nothing blocks."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.files import whole
from framework.files.locks import HOLDER, LOCK, locked
from framework.files.whole import Unwritable, write_whole
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    path = tmp_path / "elsewhere" / "precious.txt"
    path.parent.mkdir()
    path.write_text("precious")
    return path


@pytest.mark.parametrize("kind", ["link", "link to nothing", "folder"])
def test_a_lock_is_a_file_of_ours(tmp_path: Path, precious: Path, kind: str) -> None:
    path = tmp_path / "run" / LOCK
    path.parent.mkdir()
    put: dict[str, Callable[[], object]] = {
        "link": lambda: path.symlink_to(precious),
        "link to nothing": lambda: path.symlink_to(tmp_path / "new"),
        "folder": path.mkdir,
    }
    put[kind]()
    with pytest.raises(Unwritable, match=r"\.lock: expected"), locked(path.parent):
        pass
    assert precious.read_text() == "precious" and not (tmp_path / "new").exists()


def test_an_owner_that_is_none(tmp_path: Path) -> None:
    """Somebody holds the lock, and its file holds brackets without end."""
    with locked(tmp_path):
        (tmp_path / HOLDER).write_text("[" * 100_000)
        with pytest.raises(Unwritable.__base__, match="got another process"), locked(tmp_path):
            pass


def test_a_temporary_file_is_not_written_through_a_link(tmp_path: Path, precious: Path) -> None:
    """Its name is known but for the number of the process, and there may be a link for each."""
    (tmp_path / f".a.txt.{os.getpid()}.tmp").symlink_to(precious)
    write_whole(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").read_text() == "new" and precious.read_text() == "precious"
    assert not (tmp_path / "a.txt").is_symlink() and whole.is_file(tmp_path / "a.txt")


@pytest.mark.parametrize("name", ["renders", ".hydra/config.yaml", "a.log"])
def test_a_run_whose_folder_has_a_link(
    runs: FakeRuns, tmp_path: Path, precious: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    link = Path.cwd() / "study" / "runs" / "a" / name
    link.parent.mkdir(parents=True)
    link.symlink_to(precious.parent if "." not in name[1:] else precious)
    assert main(["seed=0", "hydra.run.dir=study/runs/a"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{name}: expected no link where a run writes" in line
    assert precious.read_text() == "precious" and os.listdir(precious.parent) == [precious.name]
    assert not runs.seen
