"""What SH bands above 0 cost where only some Gaussians have them: step time, memory and files.

    python benchmarks/speed/bands.py [--count 50000] [--rounds 5] [--output FILE]

A step is `render_gradient` of `photometric_gradient` and `Adam.step_from` on one thread, at 504x378
on `benchmarks.scene` with SH of degree 3; shares of bands are measured in turn. Milliseconds are
CPU time, the median over the rounds. Writes a markdown table to FILE, or prints it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import torch
from safetensors.torch import save

from benchmarks.scene import HEIGHT, WIDTH, layered_scene
from framework.compute.parallel import set_threads
from framework.compute.rng import stream
from framework.rasterize import render_gradient
from framework.rasterize.losses import Target, photometric_gradient
from framework.records.ply import write_ply
from framework.records.provenance import cpu_model
from framework.train.optim import Adam
from framework.types import Camera, Gaussians

SHARES = (1.0, 0.5, 0.1, 0.01, 0.0)
STEPS = 5  # of a round
TENSORS = 3  # parameters and Adam's two moments


class Training:
    """Steps on one set of Gaussians."""

    def __init__(self, gaussians: Gaussians, camera: Camera) -> None:
        self.gaussians, self.camera = gaussians.clone(), camera
        self.adam = Adam(gaussians)
        image = stream(0, "benchmark-target").random((3, HEIGHT, WIDTH), dtype="float32")
        self.target = Target.of(torch.from_numpy(image))

    def milliseconds(self) -> float:
        """CPU time of a step, the mean of STEPS."""
        rates = dict.fromkeys([name for name, _ in self.gaussians.items()], 1e-5)
        start = time.process_time()
        for _ in range(STEPS):
            self.adam.step_from(render_gradient(self.gaussians, self.camera, self._slope), rates)
        return 1e3 * (time.process_time() - start) / STEPS

    def _slope(self, rgb: np.ndarray) -> np.ndarray:
        return photometric_gradient(rgb, self.target)[1]


def sizes(gaussians: Gaussians) -> tuple[int, int, int]:
    """Bytes of the parameters and their moments, of the files and of a checkpoint's tensors."""
    held = TENSORS * sum(4 * tensor.numel() for _, tensor in gaussians.items())
    with tempfile.TemporaryDirectory() as folder:
        ply = write_ply(Path(folder) / "a.ply", gaussians, torch.zeros(3))
    return held, ply, TENSORS * len(save(dict(gaussians.items())))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50_000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    set_threads(1)
    whole, camera = layered_scene(options.count)
    subjects = {s: whole.replace(shN=whole.shN[: round(s * len(whole))]) for s in SHARES}
    trainings = {share: Training(subject, camera) for share, subject in subjects.items()}
    for training in trainings.values():
        training.milliseconds()
    rounds = [{s: t.milliseconds() for s, t in trainings.items()} for _ in range(options.rounds)]
    rows = []
    for share, subject in subjects.items():
        ms = statistics.median(times[share] for times in rounds)
        ratio = statistics.median(times[share] / times[SHARES[0]] for times in rounds)
        size = " | ".join(f"{n / 1e6:.1f}" for n in sizes(subject))
        rows.append(f"| {share:.0%} | {ms:.1f} | {ratio:.2f} | {size} |")
    text = (
        "# SH bands above 0 for some Gaussians\n\n"
        f"`python benchmarks/speed/bands.py --count {options.count} --rounds {options.rounds}` on"
        f" {cpu_model()}, one thread: {options.count:,} Gaussians of SH degree 3, {WIDTH}x{HEIGHT}."
        " A step with its loss, gradient and update, in CPU time; MB of the parameters with Adam's"
        " moments, of its files (PLY and bands), and of a checkpoint.\n\n"
        "| with bands | step (ms) | ratio | in memory | files | checkpoint |\n"
        "|---:|---:|---:|---:|---:|---:|\n" + "\n".join(rows) + "\n"
    )
    if options.output:
        options.output.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
