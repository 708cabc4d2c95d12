"""Real processes, really killed: a small share of `benchmarks/safety/kill.py`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from framework.command.config.schema import ROOT


def test_a_study_killed_again_and_again_equals_an_undisturbed_one(tmp_path: Path) -> None:
    """SIGKILL at a random moment and while each kind of file is written."""
    page = tmp_path / "kill.md"
    script = str(ROOT / "benchmarks" / "safety" / "kill.py")
    done = subprocess.run(
        [sys.executable, script, "--small", "--steps", "24", "--output", str(page)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    text = page.read_text(encoding="utf-8")
    assert text.splitlines()[-1].startswith("7 kills over")
    assert "report): 0. Runs lost: 0. Runs done twice: 0." in text
