"""The examples of CONTRIBUTING.md, installed as another package would be, and trained with."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from framework.command.config.schema import ROOT

EXAMPLES = ("smooth_depth", "two_nearest")


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """The environment of a process in which the examples are an installed distribution."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    site = tmp_path / "site"
    metadata = site / "examples-1.0.dist-info"
    metadata.mkdir(parents=True)
    for name, text in zip(
        EXAMPLES, re.findall(r"```python\n(.*?)```", page, re.DOTALL), strict=True
    ):
        assert f"/{name}.py`" in page
        (site / f"{name}.py").write_text(text, encoding="utf-8")
    points = "".join(f"{name} = {name}\n" for name in EXAMPLES)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: examples\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[fishersplat.plugins]\n{points}")
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


def test_they_train(installed: dict[str, str], tmp_path: Path) -> None:
    line = "+augment=two_nearest +reg=smooth_depth depth=ground_truth init.budget=2000"
    short = "trainer.steps=8 trainer.evaluations=1 hydra.run.dir=out scene.width=96 scene.height=72"
    done = run(installed, tmp_path, f"{line} {short}")
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "out" / "record.json").read_text(encoding="utf-8"))
    assert record["status"] == "complete"
    assert record["config"]["augment"]["name"] == "two_nearest"
    assert record["config"]["reg"]["name"] == "smooth_depth"
