"""A run survives the loss of its output, and an interrupt at its start is one line."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

CODE = """
import sys
from framework.command.entry import make_safe
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


@pytest.mark.parametrize("after_ms", [50])
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
