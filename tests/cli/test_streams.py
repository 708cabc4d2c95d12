"""A run survives the loss of its standard streams, and mistakes give one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.config.schema import ROOT

CODE = """
import sys
from framework.command.streams import make_safe
make_safe()
opened = open("file.txt", "w")
assert opened.fileno() > 2  # else what libraries print would end up in it
print("x" * 10, flush=True)
sys.stdout.isatty()
print("y", flush=True)
print("went on", file=sys.stderr)
"""


def test_output_that_is_closed(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.close(1),
    )
    assert done.returncode == 0 and done.stderr == "went on\n"


def test_no_stream_at_all(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", CODE],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        preexec_fn=lambda: [os.close(number) for number in range(3)],
    )
    assert done.returncode == 0


@pytest.mark.parametrize("after_ms", [50, 120])
def test_an_interrupt_at_the_start_is_one_line(tmp_path: Path, after_ms: int) -> None:
    process = subprocess.Popen(
        [sys.executable, str(ROOT / "run.py"), "seed=0,1", "-m"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    time.sleep(after_ms / 1000)
    process.send_signal(signal.SIGINT)
    message = process.communicate(timeout=60)[1]
    assert process.returncode == 130 and message.startswith("error: interrupted"), message


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("seed=range(0) -m", "multirun: seed=range(0) gives no value, so there is no run"),
        ("seed=0,1 reg=glob(zzz*) -m", "multirun: reg=glob(zzz*) gives no value"),
        ("preset=[paper,fast]", "preset: expected one choice, got a list"),
        ("method=[a,b]", "method: expected one choice, got a list"),
        ("~seed", "~seed: an option cannot be removed"),
        ("~trainer", "~trainer: an option cannot be removed"),
        ("~trainer.steps", "~trainer.steps: an option cannot be removed"),
        ("~preset", "~preset: an option cannot be removed"),
        ("--versio", "command line: unrecognized arguments: --versio"),
        ("--hel", "command line: unrecognized arguments: --hel"),
        ("study submit", "study submit: expected the words of a study, got none"),
        ("study submit -m", "study submit: expected the words of a study, got none"),
    ],
)
def test_a_slip_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    line: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert message in error and error.startswith("error: ") and error.count("\n") == 1


@pytest.mark.parametrize("make", [lambda path: path / "file" / "x", lambda path: Path("/proc/x")])
def test_a_cache_that_cannot_be_made(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    make: Callable[[Path], Path],
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(make(tmp_path)))
    monkeypatch.chdir(tmp_path)
    assert main(["trainer.steps=1"]) == 2
    assert "set FISHERSPLAT_CACHE to a folder that you may write" in capsys.readouterr().err
