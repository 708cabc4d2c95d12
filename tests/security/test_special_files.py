"""What is no file in a file's place: nobody waits for it, and one line tells it."""

from __future__ import annotations

import ast
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT
from framework.errors import UserError
from framework.files.opened import file_size, open_regular, read_bytes, read_text
from framework.files.whole import file_sha256
from tests.built import load_scene
from tests.fuzz.readers import READERS
from tests.fuzz.special import PUT

LEFT_TO_CALLER = ("checkpoint", "command line", "leaderboard", "photo names", "study")
OPENERS = ("framework/files/opened.py",)  # the one place where files from elsewhere are opened
OWN = {  # our own sources and settings, caches and what was written a moment ago
    *("framework/compute/jit.py", "framework/records/provenance.py", "framework/files/whole.py"),
    *("framework/run/plugin_code.py", "framework/command/streams.py"),
    *(
        "framework/files/locks.py",
        "framework/records/progress.py",
        "framework/scenes/embedded/generate.py",
    ),
    *("framework/report/page/html.py", "framework/command/studies/study.py"),
    # the report just written; the page's own scripts; exports just made, a film's writer; a browser
    *("framework/command/studies/closing.py", "framework/view/page.py"),
    *("framework/exports/formats.py", "framework/exports/movie.py", "framework/view/server.py"),
    *("framework/command/config/help.py", "framework/command/config/meanings.py"),
    # tables of the package itself
    *("framework/report/parts/palette.py", "framework/report/study/roles.py"),
    "framework/report/text/published.py",
    # what a search for poses has just made of photos that were opened safely; a database
    *("framework/scenes/photos/cached.py", "framework/scenes/photos/prepare.py"),
    "framework/scenes/photos/attempt.py",
    "framework/metrics/lpips_weights.py",  # an archive whose hash is checked
    "framework/train/plugged.py",  # opens a count, no file
}


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


@pytest.mark.parametrize("name", sorted(READERS.keys() - LEFT_TO_CALLER))
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


@pytest.mark.parametrize("folder", ["images_8/im03.png", "images_8/im04.png"])
def test_a_pipe_as_a_photo(tmp_path: Path, folder: str) -> None:
    from tests.scenes.synthetic import write_llff

    photo = write_llff(tmp_path) / folder
    photo.unlink()
    os.mkfifo(photo)
    for n_views in (3, 8):  # whether it trains, tests or is left out
        try:
            load_scene("llff", {"path": str(tmp_path), "n_views": n_views})
        except UserError as error:
            assert "expected a regular file, got a pipe" in str(error)


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


def test_text_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc\xff")
    with pytest.raises(UserError, match="expected text in UTF-8, got byte 0xff at 3"):
        read_text(tmp_path / "a", 100)


PARSERS = ("json.load", "json.loads", "yaml.load", "yaml.safe_load", "literal_eval")
PARSED = {  # beside the one reader of bounded plain values: what is checked right there, or own
    "framework/files/documents.py",
    "framework/scenes/transforms_file.py",  # every value that is used has its check beside it
    "framework/train/resume/checkpoint.py",  # of every class that may be a state, field by field
    "framework/run/lpips_later.py",  # the reasons in a cell: any fault is a damaged table
    "framework/files/locks.py",  # who holds a lock: any fault is "another process"
    # what processes of one command tell each other
    *("framework/command/runner.py", "framework/run/experiment.py", "framework/run/warmup.py"),
    *("framework/scenes/photos/search.py", "framework/scenes/photos/child.py"),
    "framework/command/studies/study.py",
}
WRITERS = {  # beside `write_whole` and the locks: temporary or own folders, the cache, /proc
    *("framework/files/whole.py", "framework/files/locks.py"),
    *("framework/files/tidy.py", "framework/run/warmup.py", "framework/records/provenance.py"),
    *("framework/metrics/lpips_weights.py", "framework/scenes/colmap_model.py"),
    "framework/scenes/photos/attempt.py",
    "framework/exports/movie.py",  # a file that the command line names
}
SOURCES = sorted((ROOT / "framework").rglob("*.py"))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_from_elsewhere_are_opened_at_one_place(path: Path) -> None:
    """No `open`, `read_text` or their like but where our own files are read."""
    name = path.relative_to(ROOT).as_posix()
    if name in OPENERS or name in OWN:
        return
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            called = node.func.attr
            assert called not in ("read_text", "read_bytes", "imread", "copyfile")
            archive = ast.unparse(node.func.value) in ("archive", "zipfile", "Image")
            assert called != "open" or archive, ast.unparse(node)
        elif isinstance(node, ast.Call):
            assert ast.unparse(node.func) != "open", ast.unparse(node)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_text_becomes_values_at_one_place(path: Path) -> None:
    """Bounded and typed (`framework.files.documents`), or checked where it is read."""
    if path.relative_to(ROOT).as_posix() in PARSED:
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            assert ast.unparse(node.func) not in PARSERS, ast.unparse(node)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_files_are_written_at_one_place(path: Path) -> None:
    """Whole or not at all, and never through a link: `framework.files.whole`."""
    if path.relative_to(ROOT).as_posix() in WRITERS:
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute | ast.Name):
            continue
        called = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
        assert called not in ("write_text", "write_bytes", "touch"), ast.unparse(node)
        modes = [value.value for value in node.args if isinstance(value, ast.Constant)]
        writes = any(isinstance(mode, str) and mode[:1] in "wax" and mode for mode in modes)
        assert called != "open" or not writes, ast.unparse(node)
