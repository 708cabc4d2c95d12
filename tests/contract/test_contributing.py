"""The example of CONTRIBUTING.md, installed as another package would be, and trained with."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from framework.config import ROOT

ENTRY_POINT = "[fishersplat.plugins]\nsmooth_depth = smooth_depth\n"


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """The environment of a process in which the example is an installed distribution."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    example = re.search(r"```python\n(.*?)```", page, re.DOTALL)
    assert example is not None
    site = tmp_path / "site"
    metadata = site / "smooth_depth-1.0.dist-info"
    metadata.mkdir(parents=True)
    (site / "smooth_depth.py").write_text(example.group(1), encoding="utf-8")
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: smooth_depth\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINT)
    return {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}


def run(environment: dict[str, str], folder: Path, line: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), *line.split()],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_it_is_a_choice_like_any_other(installed: dict[str, str], tmp_path: Path) -> None:
    done = run(installed, tmp_path, "--help reg=smooth_depth")
    assert done.returncode == 0, done.stderr
    line = next(line for line in done.stdout.splitlines() if line.startswith("    smooth_depth"))
    assert "neighbouring pixels should see similar depth" in line
    assert "edge: 10.0" in done.stdout and "weight: 0.01" in done.stdout


def test_its_check_is_a_one_line_error(installed: dict[str, str], tmp_path: Path) -> None:
    done = run(installed, tmp_path, "reg=smooth_depth reg.edge=-1")
    assert done.returncode == 2
    assert done.stderr == "error: smooth_depth: expected edge >= 0, got -1.0; raise it\n"


def test_it_trains(installed: dict[str, str], tmp_path: Path) -> None:
    line = "+reg=smooth_depth depth=ground_truth trainer.steps=8 trainer.evaluations=1"
    done = run(installed, tmp_path, f"{line} init.budget=2000 hydra.run.dir=out")
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "record.json").read_text(encoding="utf-8"))
    assert record["status"] == "complete"
    assert record["config"]["reg"]["name"] == "smooth_depth"
