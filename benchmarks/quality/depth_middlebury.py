"""Plane sweep compared with OpenCV's semi-global matcher on a rectified pair with measured depth.

    python benchmarks/quality/depth_middlebury.py DIR [--output FILE.md]

DIR holds `images/left.png`, `images/right.png`, `depth_left.npz` (key `depth_mm`, 0 = unknown) and
a COLMAP model in `sparse/0`. Its 3D points are drawn from the measured depth, so they are not used:
both methods search the disparities from 0 to 80 pixels. Prints a table, and writes it
to the file of `--output`.
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import torch
from numpy.typing import NDArray
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.compute.parallel import threads
from framework.depth.matching.neighbours import FARTHER, NEARER
from framework.depth.providers import PlaneSweep
from framework.types import Camera, SparsePoints, TrainingSet, View

DISPARITIES = 80
TOLERANCES = (0.01, 0.03)
Map = NDArray[np.float32]


@dataclass(frozen=True)
class Outcome:
    """depth: [H, W] of the left view, 0 = none. confident: [H, W]. cpu_s: processor seconds."""

    name: str
    depth: Map
    confident: NDArray[np.bool_]
    cpu_s: float


def load_view(model: pycolmap.Reconstruction, folder: Path, name: str) -> View:
    """One photo with its camera."""
    image = next(i for i in model.images.values() if i.name == name)
    camera = model.cameras[image.camera_id]
    pose = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
    pixels = np.asarray(Image.open(folder / "images" / name).convert("RGB"), np.float32)
    return View(
        name,
        Camera(
            torch.from_numpy(pose),
            torch.from_numpy(camera.calibration_matrix()),
            camera.width,
            camera.height,
        ),
        torch.from_numpy(pixels.transpose(2, 0, 1) / 255),
    )


def load_pair(folder: Path) -> TrainingSet:
    """Both photos, without sparse points, bounded by the searched disparities."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    views = tuple(load_view(model, folder, name) for name in ("left.png", "right.png"))
    none = SparsePoints(
        torch.zeros((0, 3), dtype=torch.float64), torch.zeros((0, 3)), torch.zeros((0, 2)).bool()
    )
    near, far = depth_of(views, np.array([DISPARITIES, 0.0]))
    # plane_sweep widens the bounds of a scene, which here are already those to search
    return TrainingSet("pair", views, none, float(near) / NEARER, float(far) / FARTHER)


def depth_of(views: tuple[View, ...], disparity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth = focal x baseline / (disparity + difference of the principal points)."""
    left, right = (view.camera for view in views)
    baseline = float((right.center - left.center).norm())
    offset = float(right.K[0, 2] - left.K[0, 2])
    return float(left.K[0, 0]) * baseline / (disparity + offset)


def run_plane_sweep(pair: TrainingSet) -> Outcome:
    """Ours, timed on its second run: the first one compiles."""
    provider = PlaneSweep()
    provider.estimate(pair)
    start = time.process_time()
    left = provider.estimate(pair)[0]
    seconds = time.process_time() - start
    return Outcome(
        "plane_sweep (both views)", left.depth.numpy(), left.confidence.numpy() > 0, seconds
    )


def run_sgbm(pair: TrainingSet, checked: bool) -> Outcome:
    """StereoSGBM, eight paths, with the settings of OpenCV's sample; `checked` adds its left-right,
    uniqueness and speckle filters."""
    left, right = (
        cv2.cvtColor(
            (v.image.numpy() * 255).round().astype(np.uint8).transpose(1, 2, 0), cv2.COLOR_RGB2BGR
        )
        for v in pair.views
    )
    block, channels = 3, 3
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=DISPARITIES,
        blockSize=block,
        P1=8 * channels * block**2,
        P2=32 * channels * block**2,
        disp12MaxDiff=1 if checked else -1,
        preFilterCap=63,
        uniquenessRatio=10 if checked else 0,
        speckleWindowSize=100 if checked else 0,
        speckleRange=32 if checked else 0,
        mode=cv2.StereoSGBM_MODE_HH,
    )
    # the padding lets the matcher search the whole range at the left border too
    padded = [
        cv2.copyMakeBorder(i, 0, 0, DISPARITIES, 0, cv2.BORDER_REPLICATE) for i in (left, right)
    ]
    start = time.process_time()
    disparity = matcher.compute(*padded)[:, DISPARITIES:].astype(np.float64) / 16
    seconds = time.process_time() - start
    valid = disparity >= 0
    depth = np.where(valid, depth_of(pair.views, np.maximum(disparity, 0)), 0)
    name = "StereoSGBM, filtered" if checked else "StereoSGBM, dense"
    return Outcome(name, depth.astype(np.float32), valid, seconds)


def row(outcome: Outcome, truth: Map) -> str:
    """A table row: shares of measured pixels, then density and shares of confident ones."""
    measured = truth > 0
    error = np.abs(outcome.depth[measured] / truth[measured] - 1)
    confident = outcome.confident[measured]
    shares = [100 * (error < t).mean() for t in TOLERANCES]
    shares.append(100 * confident.mean())
    shares += [100 * (error[confident] < t).mean() for t in TOLERANCES]
    cells = " | ".join(f"{share:.1f}" for share in shares)
    return f"| {outcome.name} | {cells} | {outcome.cpu_s:.2f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare the plane sweep with StereoSGBM.")
    parser.add_argument("folder", type=Path, metavar="DIR")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    folder = options.folder
    pair = load_pair(folder)
    truth: Map = np.load(folder / "depth_left.npz")["depth_mm"]
    outcomes = [run_plane_sweep(pair), run_sgbm(pair, False), run_sgbm(pair, True)]
    table = "\n".join(
        [
            "| method | all < 1 % | all < 3 % | confident | of these < 1 % | < 3 % | CPU s |",
            "|---|---|---|---|---|---|---|",
            *[row(outcome, truth) for outcome in outcomes],
        ]
    )
    width, height = pair.views[0].camera.width, pair.views[0].camera.height
    text = (
        f"# Depth of `{folder.name}`, left view\n\n"
        f"`python benchmarks/quality/depth_middlebury.py DIR`, {width}x{height}, disparities 0 to"
        f" {DISPARITIES}, OpenCV {cv2.__version__}, {platform.machine()}, {threads()} threads.\n"
        "Percent of the pixels with measured depth whose relative depth error is below 1 % and 3 %;"
        " `confident` is\nthe share a method vouches for. A pixel without an estimate counts as"
        " wrong under `all`.\n\n"
        f"{table}\n"
    )
    print(text)
    if options.output is not None:
        options.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
