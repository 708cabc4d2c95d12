"""What the system, Hydra's grammar or the memory refuse ends in one line, never in a traceback."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.complaints import one_line, with_variant
from framework.command.config.schema import ROOT
from framework.command.studies.failures import kind_of
from framework.errors import mendable, os_line, out_of_memory
from framework.files import cache
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture

LONG = "a" * 300
LINES = {
    f"seed={'1' * 5000}": "expected values of a usual length, got others",
    f"-m seed=1,{'1' * 5000}": "expected values of a usual length",
    "=3": "cannot read '=3'; write KEY=VALUE",
    "=3 -m": "cannot read '=3'",
    "experiment=3": "expected options of the configuration, got what Hydra refuses (Config group",
    "-m reg.start=interval(0,1)": "reg.start=interval(0,1): expected a list of values, such as",
    "-m seed=range(0,nan)": "expected finite bounds and step",
    "-m seed=range(0,inf)": "expected finite bounds and step",
    "scene.path=\udcff scene=colmap": "command line: expected UTF-8",
    f"study={LONG}": "got 'File name too long'; correct the path",
    f"study={LONG} -m": "got 'File name too long'; correct the path",
    f"hydra.run.dir={LONG}": "got 'File name too long'; correct the path",
    f"scene=colmap scene.path={'b' * 4000}": "got 'File name too long'; correct the path",
    "hydra.run.dir=/dev/null/x": "got 'Not a directory'; correct the path",
}


@pytest.mark.parametrize("line", LINES, ids=[str(i) for i in range(len(LINES))])
def test_a_line_is_answered_by_a_line(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main(line.split()) == 2
    message = capsys.readouterr().err
    assert LINES[line] in message and message.startswith("error: ")
    assert message.count("\n") == 1 and len(message) < 1010
    assert not runs.seen


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (OSError(errno.ENAMETOOLONG, "File name too long", "a" * 500), 2, "File name too long"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "(FISHERSPLAT_CACHE): expected room"),
        (OSError(errno.EROFS, "Read-only file system", "/x"), 2, "/x: expected what may be opened"),
        (OSError(errno.ELOOP, "Too many links", "/x"), 2, "/x: expected what may be opened"),
        (FileNotFoundError(errno.ENOENT, "No such file", "/x"), 2, "/x: expected a file or folder"),
        (MemoryError("Unable to allocate 9 GiB"), 2, "memory: expected room for the run, got 'Una"),
        (RuntimeError("DefaultCPUAllocator: can't allocate memory: you"), 2, "memory: expected"),
        (RuntimeError("can't start new thread"), 2, "memory: expected room for the run"),
        (ImportError("libx.so: failed to map segment from shared object"), 2, "memory: expected"),
        (OSError(errno.ENOMEM, "Cannot allocate memory", "/x"), 2, "memory: expected"),
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


def test_only_what_a_user_can_mend_is_bad_input() -> None:
    assert not mendable(OSError(errno.EMFILE, "Too many open files", "/x"))
    assert not mendable(OSError(errno.EBADF, "Bad file descriptor"))
    assert not mendable(ConnectionResetError(errno.ECONNRESET, "reset", "/x"))
    assert not out_of_memory(KeyError("bad_alloc"))
    assert "\ufffd" in one_line(OSError(errno.ELOOP, "x", "/\udcff"))
    assert "\ufffd" in os_line(OSError(errno.ELOOP, "x", b"/\xff"))


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit address space")
@pytest.mark.parametrize("command", [["run.py", "seed=0"], ["run.py", "report", "."]])
def test_too_little_address_space(command: list[str], tmp_path: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (700 << 20, 700 << 20))

    words = [str(ROOT / word) if word == "run.py" else word for word in command]
    process = subprocess.run(
        [sys.executable, *words],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        preexec_fn=limit,
        check=False,
    )
    assert process.returncode == 2 and process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert line.startswith("error: memory: expected room for the run, got '700 MiB of address")


FULL = """
import sys
sys.path.insert(0, {root!r})
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
import numba
import framework.compute.jit as jit
from framework.command import runner
from framework.command.cli import main

@jit.kernel
def add(a, b):
    return a + b

def run(job):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))  # every file is full at once
    try:
        add(1, 2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)

runner.run = run
sys.exit(main(["seed=0"]))
"""


def test_a_full_kernel_cache(tmp_path: Path) -> None:
    (tmp_path / "run_it.py").write_text(FULL.format(root=str(ROOT)))
    process = subprocess.run(
        [sys.executable, "run_it.py"],
        cwd=tmp_path,
        env={**os.environ, "FISHERSPLAT_CACHE": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 2 and process.stdout == ""
    (line,) = process.stderr.splitlines()
    assert "File too large" in line and "free some space" in line


def test_a_report_without_memory(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fail(*_: object) -> None:
        raise MemoryError("Unable to allocate 9 GiB")

    monkeypatch.setattr("framework.report.build.built", fail)
    assert main(["report", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("error: memory: expected room")


def test_a_missing_depth_names_the_recipe_without_a_network() -> None:
    text = with_variant("depth=file: expected a folder", ["preset=paper", "+method=fsgs,corgs"])
    assert text.endswith("take the plane sweep instead of a network: method=fsgs_sweep")
    for message, words in (
        ("depth=file: expected a folder", ["method=corgs"]),
        ("scene.path: expected a folder", ["method=fsgs"]),
    ):
        assert with_variant(message, words) == message


def test_a_cache_of_its_own_needs_no_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody)
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / "own"))
    assert cache.cache_dir() == tmp_path / "own"
