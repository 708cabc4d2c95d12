"""A study of many runs, three of which a plugin breaks, is complete in any order and by joblib."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.studies import digests, leftovers, parameters
from framework.command.config.schema import ROOT
from framework.compute.rng import stream

pytestmark = pytest.mark.slow

RUNS, BROKEN = 60, 3
STUDY = [
    *("study=many", "reg=fragile", "threads=1", "depth=ground_truth", "init.budget=300"),
    *("scene.width=64", "scene.height=48", "scene.supersampling=1"),
    *("trainer.steps=12", "trainer.evaluations=1", "metrics.lpips_weights=none"),
]
ENTRY_POINT = "[fishersplat.plugins]\nfragile = fragile\n"
PLUGIN = '''"""`reg=fragile`: breaks for the seeds whose first draw is small."""

from dataclasses import dataclass

from framework.plugin import Regularizer, register


@register("reg", "fragile")
@dataclass(frozen=True)
class Fragile(Regularizer):
    """below: seeds with a smaller first draw fail, some of them by a loss of NaN."""

    below: float = 0.0

    def loss(self, ctx, state, view, render):
        draw = ctx.rng("fate").random()
        if ctx.step > 0 or draw >= self.below:
            return None
        if int(draw * 1e8) % 2:
            return render.rgb.sum() * float("nan")
        raise RuntimeError("planted")
'''


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the plugin as an installed distribution."""
    folder = tmp_path_factory.mktemp("site")
    metadata = folder / "fragile-1.0.dist-info"
    metadata.mkdir()
    (folder / "fragile.py").write_text(PLUGIN, encoding="utf-8")
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fragile\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINT)
    return folder


def study(folder: Path, site: Path, words: list[str]) -> Path:
    """The study in a separate process, which fails, as three of its runs do."""
    folder.mkdir()
    environment = {**os.environ, "PYTHONPATH": f"{site}{os.pathsep}{ROOT}"}
    command = [sys.executable, str(ROOT / "run.py"), "-m", *STUDY, *words]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    return folder / "reports" / "many"


def test_many_runs_are_complete_and_the_failures_listed(tmp_path: Path, site: Path) -> None:
    draws = sorted((stream(seed, "reg/fate").random(), seed) for seed in range(RUNS))
    broken = sorted(seed for _, seed in draws[:BROKEN])
    below = f"reg.below={(draws[BROKEN - 1][0] + draws[BROKEN][0]) / 2!r}"
    joblib = ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
    studies = [
        study(tmp_path / "forwards", site, [below, f"seed=range({RUNS})"]),
        study(tmp_path / "backwards", site, [below, f"seed=range({RUNS - 1},-1,-1)"]),
        study(tmp_path / "joblib", site, [below, *joblib, f"seed=range({RUNS})"]),
    ]
    expected = digests(studies[0])
    for one in studies:
        report = (one / "report.md").read_text(encoding="utf-8")
        failed = [path.parent.name for path in one.glob("runs/*/failed.json")]
        assert sorted(int(name.split("-s")[1].split("-")[0]) for name in failed) == broken
        assert all(name in report for name in failed)
        assert len(parameters(one)) == RUNS - BROKEN
        assert leftovers(one) == []
        assert digests(one) == expected
