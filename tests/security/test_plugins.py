"""Plugins come from the plugins folder and from installed entry points, from nowhere else."""

import os
import subprocess
import sys
from pathlib import Path

from framework.command.config.schema import ROOT

PLUGIN = """
from dataclasses import dataclass
from pathlib import Path
from framework.plugin import Regularizer, register
Path("imported").touch()
@register("reg", "foreign")
@dataclass(frozen=True)
class Foreign(Regularizer):
    def loss(self, ctx, state, view, render):
        return None
"""


def run(folder: Path, path: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(ROOT / "run.py"), "reg=foreign", "--cfg", "job"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        timeout=60,
    )


def install(site: Path, source: str) -> None:
    metadata = site / "foreign-1.0.dist-info"
    metadata.mkdir(parents=True)
    (site / "foreign.py").write_text(source)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text("[fishersplat.plugins]\nforeign = foreign\n")


def test_a_module_that_is_merely_there_is_not_imported(tmp_path: Path) -> None:
    for folder in ("", "plugins", "plugins/regularize", "conf"):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / "foreign.py").write_text(PLUGIN)
    done = run(tmp_path, str(tmp_path))
    assert done.returncode == 2 and "reg=foreign: unknown reg" in done.stderr
    assert not (tmp_path / "imported").exists()


def test_an_installed_entry_point_is(tmp_path: Path) -> None:
    install(tmp_path / "site", PLUGIN)
    done = run(tmp_path, str(tmp_path / "site"))
    assert done.returncode == 0, done.stderr
    assert "name: foreign" in done.stdout
