"""A run survives the loss of its output, and an interrupt at its start is one line."""

import os
import subprocess
import sys
from pathlib import Path

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
