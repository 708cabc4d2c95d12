"""Peak memory of a training, in addition to the interpreter, its libraries and the kernels.

Each case runs in a separate process: three views, SH of degree 3, a few steps of the trainer,
without methods. The base is the resident size after a training of 1000 Gaussians on tiny images.
The last line fits peak = a x Gaussians + b x pixels, with the pixels of all training views.

    python benchmarks/speed/memory.py [--output benchmarks/results/memory.md]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

COUNTS = (50_000, 100_000, 300_000)
FACTORS = (1, 2)  # of 504x378 pixels
PER_GAUSSIAN, PER_PIXEL, VIEWS, STEPS = 1500, 60, 3, 4


@dataclass(frozen=True)
class Case:
    """base, peak: resident bytes."""

    count: int
    width: int
    height: int
    base: int
    peak: int

    @property
    def over(self) -> int:
        return self.peak - self.base

    @property
    def pixels(self) -> int:
        return VIEWS * self.width * self.height

    @property
    def allowed(self) -> int:
        return PER_GAUSSIAN * self.count + PER_PIXEL * self.pixels


def train(count: int, factor: float) -> tuple[int, int]:
    """Train `count` Gaussians for a few steps on images larger by `factor`; returns their size."""
    import torch

    from benchmarks.scene import layered_scene
    from framework.compute.rng import stream
    from framework.options import TrainerOptions
    from framework.records.progress import Silent
    from framework.run.members import IDLE
    from framework.train.trainer import Plugins, Trainer
    from framework.types import Camera, SparsePoints, TrainingSet, View

    gaussians, camera = layered_scene(count, factor=factor)
    width, height = camera.width, camera.height
    views = []
    for i in range(VIEWS):
        viewmat = torch.eye(4)
        viewmat[0, 3] = -0.1 * i
        pixels = stream(i, "benchmark-target").random((3, height, width), dtype="float32")
        views.append(
            View(f"{i}", Camera(viewmat, camera.K, width, height), torch.from_numpy(pixels))
        )
    seen = torch.ones(1, VIEWS, dtype=torch.bool)
    points = SparsePoints(torch.ones(1, 3, dtype=torch.float64), torch.ones(1, 3), seen)
    options = TrainerOptions(steps=STEPS, sh_degree=3, sh_every=1)
    training = TrainingSet("memory", tuple(views), points, 1.0, 30.0)
    trainer = Trainer(training, (), gaussians, options, Plugins.of(IDLE), 0, Silent())
    del gaussians  # as `framework.run.training` does
    trainer.run()
    return width, height


def worker(count: int, factor: int) -> None:
    """Print one case as JSON."""
    from framework.records.provenance import peak_memory_bytes, reset_peak_memory

    train(1000, 0.125)
    if not reset_peak_memory():
        raise SystemExit("error: needs Linux, whose /proc reports the peak")
    base = peak_memory_bytes()
    width, height = train(count, factor)
    case = Case(count, width, height, base, peak_memory_bytes())
    print(json.dumps(case.__dict__))


def measure(count: int, factor: int) -> Case:
    """One case in a fresh process."""
    command = [sys.executable, __file__, "--case", str(count), str(factor)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    return Case(**json.loads(done.stdout.splitlines()[-1]))


def table(cases: list[Case]) -> str:
    import numpy as np

    lines = ["`python benchmarks/speed/memory.py`", ""]
    lines += ["| Gaussians | image | base MB | peak over it MB | 1.5 KB + 60 B/px MB | share |"]
    lines += ["|---|---|---|---|---|---|"]
    for case in cases:
        numbers = f"{case.base / 1e6:.0f} | {case.over / 1e6:.0f} | {case.allowed / 1e6:.0f}"
        size = f"{case.count:,} | {case.width}x{case.height}"
        lines.append(f"| {size} | {numbers} | {case.over / case.allowed:.2f} |")
    rows = np.array([[case.count, case.pixels] for case in cases], float)
    (a, b), *_ = np.linalg.lstsq(rows, np.array([case.over for case in cases], float), rcond=None)
    fit = f"Fitted: {a:.0f} bytes per Gaussian and {b:.0f} per pixel of the {VIEWS} training views."
    return "\n".join([*lines, "", fit]) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path)
    parser.add_argument("--case", nargs=2, type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        worker(*options.case)
        return 0
    cases = [measure(count, factor) for factor in FACTORS for count in COUNTS]
    text = table(cases)
    print(text)
    if options.output is not None:
        options.output.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
