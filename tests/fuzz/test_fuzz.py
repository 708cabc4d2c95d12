"""Mutated inputs of every reader: each ends in the documented error or in a correct read; no crash,
no hang, no memory beyond the limit. `tests/system/test_fuzz.py` does the same for longer."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from framework.errors import UserError, printable_line
from framework.files.arrays import read_npy
from framework.files.paths import inside
from tests.fuzz.drive import fuzz, watched
from tests.fuzz.readers import READERS

CASES, DEAR_CASES = 6, 2  # of each reader
DEAR = {"study", "archive of runs", "compared runs"}  # up to half a second each
RARE = {"leaderboard"}  # refuses one in twenty; `tests/system/test_fuzz.py` does it


@pytest.mark.skipif(sys.platform != "linux", reason="the worker's limits are those of Linux")
def test_mutated_inputs_end_in_the_documented_error_or_a_read(tmp_path: Path) -> None:
    cheap = [name for name in READERS if name not in DEAR | RARE]
    for readers, cases in ((cheap, CASES), (sorted(DEAR), DEAR_CASES)):
        tally = fuzz(tmp_path / "results", readers, cases, seed=0)
        assert tally.bugs == []
        assert tally.cases == cases * len(readers)
        counts = sum(tally.counts.values(), Counter())
        assert counts["refused"] and counts["read"]


class _Worker:
    """Notes something in each of its first waits, and ends in the last; killed, it ends at once."""

    def __init__(self, results: Path, notes: int, waits: int) -> None:
        self.results, self.notes, self.waits = results, notes, waits

    def wait(self, timeout: float | None = None) -> int:
        self.waits -= 1
        if self.waits < 0 or timeout is None:
            return 0 if timeout else -signal.SIGKILL
        if self.notes > 0:
            self.notes -= 1
            self.results.write_text(f"{self.results.read_text()}x")
        raise subprocess.TimeoutExpired("worker", timeout)

    def kill(self) -> None: ...


@pytest.mark.parametrize(("notes", "code"), [(100, 0), (3, -signal.SIGKILL)])
def test_only_a_worker_that_notes_nothing_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, notes: int, code: int
) -> None:
    """However long all cases take: each has a limit of its own."""
    (tmp_path / "results").touch()
    worker = _Worker(tmp_path / "results", notes, waits=50)
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: worker)
    assert watched(["worker"], tmp_path / "results") == code


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.text(st.characters(exclude_categories=[]), max_size=80))
def test_a_name_stays_inside_its_folder_or_is_refused(name: str) -> None:
    folder = Path(__file__).parent
    try:
        path = inside(folder, name)
    except UserError as error:
        assert "\n" not in str(error)
    else:
        assert path.resolve().is_relative_to(folder)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.text(st.characters(exclude_categories=[]), max_size=3000))
def test_every_message_is_one_printable_line(text: str) -> None:
    line = printable_line(text)
    assert line.isprintable() and len(line) <= 1000
    assert str(UserError(text)) == line


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    shape=st.lists(st.integers(0, 4), max_size=4).map(tuple),
    kind=st.sampled_from(["<f4", ">f8", "<i2", "|u1", "|b1"]),
    fortran=st.booleans(),
)
def test_arrays_are_read_back(
    tmp_path_factory: pytest.TempPathFactory, shape: tuple[int, ...], kind: str, fortran: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "array.npy"
    values = np.arange(np.prod(shape, dtype=int)).reshape(shape).astype(kind)
    np.save(path, np.asfortranarray(values) if fortran else values)
    read = read_npy(path)
    assert read.dtype == values.dtype
    np.testing.assert_array_equal(read, values)
