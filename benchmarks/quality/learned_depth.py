"""How often is depth right to 1 %, by the network's confidence?

    python benchmarks/quality/learned_depth.py DIR

DIR is the folder of the scenes (docs/scenes.md). Depth is compared at the sparse points that two or
more training photos show. Needs `fishersplat fetch itermvs --from FILE`.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from framework import registry
from framework.depth.consistency import agreeing_views
from framework.depth.itermvs.views import SURE_TOLERANCE, estimate_views
from framework.depth.options import IterMvsOptions
from framework.depth.providers import PlaneSweep
from framework.depth.transfer import inside, project
from framework.types import TrainingSet

SCENES: dict[str, dict[str, Any]] = {  # those that may choose settings
    "fern": {"name": "llff", "path": "llff_fern", "n_views": 3, "downscale": 2},
    "scan 24": {"name": "dtu", "path": "dtu_scan24", "n_views": 3, "downscale": 2},
    "door": {"name": "colmap", "path": "lund_door", "n_views": 3, "downscale": 2},
    "fox": {"name": "transforms", "path": "nerf_fox", "n_views": 12, "downscale": 2},
}
EDGES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 1.01)
RIGHT = 0.01


@dataclass(frozen=True)
class Samples:
    """Depth at the sparse points of all views, [P] each.

    Attributes:
        error: relative error of the network.
        swept: relative error of the plane sweep.
        confidence: of the network.
        agrees: another view confirms the network within 1 %.
        consistent: another view confirms the plane sweep.
        seconds: CPU seconds of the network.
    """

    error: NDArray[np.float64]
    swept: NDArray[np.float64]
    confidence: NDArray[np.float32]
    agrees: NDArray[np.bool_]
    consistent: NDArray[np.bool_]
    seconds: float


def samples(training: TrainingSet) -> Samples:
    """Measure both kinds of depth at the sparse points."""
    start = time.process_time()
    estimates = estimate_views(training, IterMvsOptions())
    seconds = time.process_time() - start
    swept = PlaneSweep().measure(training)
    depths = [depth for depth, _ in estimates]
    cameras = [view.camera for view in training.views]
    columns: list[list[NDArray[Any]]] = [[] for _ in range(5)]
    for i, camera in enumerate(cameras):
        seen = training.points.visible[:, i].numpy()
        uvz = project(camera, training.points.xyz.numpy()[seen])
        uvz = uvz[inside(camera, uvz)]
        x, y, z = uvz[:, 0].astype(int), uvz[:, 1].astype(int), uvz[:, 2]
        others = [j for j in range(len(cameras)) if j != i]
        agreeing = agreeing_views(depths, cameras, i, others, SURE_TOLERANCE)
        values = (
            np.abs(depths[i][y, x] / z - 1),
            np.abs(swept[i].depth.numpy()[y, x] / z - 1),
            estimates[i][1][y, x],
            agreeing[y, x] > 0,
            swept[i].confidence.numpy()[y, x] > 0,
        )
        for column, value in zip(columns, values, strict=True):
            column.append(value)
    return Samples(*(np.concatenate(column) for column in columns), seconds)  # type: ignore[arg-type]


def share(right: NDArray[np.bool_], of: NDArray[np.bool_]) -> str:
    """The share of `right` among `of`, or "" for too few."""
    return f"{right[of].mean():.2f}" if of.sum() >= 20 else ""


def main(folder: Path) -> None:
    """Print both tables."""
    torch.set_num_threads(1)
    registry.discover()
    print("| scene | network | plane sweep | covered by consistent sweep | CPU s a view |")
    print("|---|---:|---:|---:|---:|")
    measured = {}
    for name, options in SCENES.items():
        loader = registry.part("scene", {**options, "path": str(folder / options["path"])})
        training = loader.load().training
        measured[name] = s = samples(training)
        right, swept = (s.error < RIGHT).mean(), (s.swept < RIGHT).mean()
        seconds = s.seconds / len(training.views)
        print(f"| {name} | {right:.2f} | {swept:.2f} | {s.consistent.mean():.2f} | {seconds:.2f} |")
    print("\n| scene | confidence | share | right | confirmed | right | sweep there |")
    print("|---|---|---:|---:|---:|---:|---:|")
    for name, s in measured.items():
        for low, high in pairwise(EDGES):
            bin_ = (s.confidence >= low) & (s.confidence < high)
            cells = (
                f"{bin_.mean():.2f}",
                share(s.error < RIGHT, bin_),
                share(s.agrees, bin_),
                share(s.error < RIGHT, bin_ & s.agrees),
                share(s.swept < RIGHT, bin_ & s.agrees),
            )
            print(f"| {name} | {low:.1f} to {min(high, 1):.1f} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
