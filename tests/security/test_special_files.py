"""Special files in place of a file: nothing blocks, and one line reports them."""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.files.opened import file_size, open_regular, read_bytes, read_text
from framework.files.whole import file_sha256
from tests.fuzz.mutate import PUT
from tests.fuzz.readers import READERS

QUICK = ("splat ply", "colmap binary", "llff poses", "transforms json", "image png", "depth npy")


@pytest.fixture(autouse=True)
def waits_end() -> Iterator[None]:
    """A test that waits for a pipe fails after 20 s."""
    signal.alarm(20)
    yield
    signal.alarm(0)


@pytest.mark.parametrize("put", [*PUT, os.mkfifo], ids=range(len(PUT) + 1))
def test_only_regular_files_are_opened(tmp_path: Path, put: Callable[[Path], object]) -> None:
    path = tmp_path / "a"
    put(path)
    readers: list[Callable[[Path], object]] = [file_sha256]
    readers += [lambda p, read=read: read(p, 100) for read in (read_bytes, read_text, open_regular)]
    for read in readers:
        with pytest.raises(UserError, match=r"a: expected"):
            read(path)


@pytest.mark.parametrize("name", (*QUICK, "run record", "viewed run", "lpips weights"))
def test_no_reader_waits_for_a_pipe(tmp_path: Path, name: str) -> None:
    reader = READERS[name]
    reader.make(tmp_path)
    for file in reader.files:
        path = tmp_path / file
        kept = path.read_bytes()
        path.unlink()
        os.mkfifo(path)
        with pytest.raises((UserError, ValueError)) as caught:
            reader.read(tmp_path)
        assert "\n" not in str(caught.value)
        path.unlink()
        path.write_bytes(kept)


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    for name in ("x" * 300, "a/" * 3000, "a\0b", "\ud800"):
        for read in (read_bytes, read_text, file_size):
            with pytest.raises(UserError) as caught:
                read(tmp_path / name, 100)
            assert str(caught.value).isprintable()


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        file.truncate(1 << 40)  # a hole
    with pytest.raises(UserError, match="expected a file of at most 100 bytes"):
        read_bytes(tmp_path / "a", 100)
