"""False alarms, misses and seconds of the pose check on real scenes, sound and spoiled.

    python benchmarks/quality/pose_check.py DATA [SCENE ...]   # DATA: the folder of public scenes

Prints one row per scene and number of training views: the ratio as given, and spoiled in seven
ways. Bold ratios are on the wrong side of the limit.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework import registry
from framework.depth.pose_check import LIMIT, check_poses
from framework.errors import UserError
from framework.types import Camera, TrainingSet, View

VIEWS = (2, 3, 6, 12, "all")
SCENES = {
    "llff_fern": "llff",
    "llff_horns": "llff",
    "llff_fortress": "llff",
    "llff_room": "llff",
    "dtu_scan24": "dtu",
    "dtu_scan65": "dtu",
    "lund_door": "colmap",
    "mip360_kitchen": "mip360",
    "nerf_fox": "transforms",
    "strecha_fountain": "colmap",
    "strecha_herzjesu": "colmap",
    "middlebury_motorcycle": "colmap",
}
FLIP = torch.diag(torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64))


def _posed(change: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[TrainingSet], TrainingSet]:
    def spoil(training: TrainingSet) -> TrainingSet:
        views = [
            replace(v, camera=replace(v.camera, viewmat=change(v.camera.viewmat)))
            for v in training.views
        ]
        return replace(training, views=tuple(views))

    return spoil


def _mirrored(viewmat: torch.Tensor) -> torch.Tensor:
    pose = torch.linalg.inv(viewmat)
    pose[0, 3] *= -1
    return torch.linalg.inv(pose)


def _turned(quarters: int) -> Callable[[TrainingSet], TrainingSet]:
    """Photos stored turned, with the cameras of upright ones (of the stored size)."""

    def turn(view: View) -> View:
        image = torch.rot90(view.image, quarters, (1, 2)).contiguous()
        mask = None if view.mask is None else torch.rot90(view.mask, quarters, (0, 1)).contiguous()
        camera, K = view.camera, view.camera.K.clone()
        if quarters % 2:
            K[0, 2], K[1, 2] = view.camera.K[1, 2], view.camera.K[0, 2]
            camera = Camera(camera.viewmat, K, camera.height, camera.width)
        return replace(view, image=image, mask=mask, camera=camera, depth=None)

    return lambda training: replace(training, views=tuple(map(turn, training.views)))


def _renamed(training: TrainingSet) -> TrainingSet:
    """Photos in another order: every camera gets the photo of about half the views further on."""
    views = training.views
    shift = max(1, len(views) // 2)
    order = [*views[shift:], *views[:shift]]
    renamed = [replace(v, image=o.image, mask=o.mask) for v, o in zip(views, order, strict=True)]
    return replace(training, views=tuple(renamed))


def _farther(training: TrainingSet) -> TrainingSet:
    """Depth bounds of another scale, and no points that contradict them."""
    none = replace(
        training.points,
        xyz=training.points.xyz[:0],
        rgb=training.points.rgb[:0],
        visible=training.points.visible[:0],
    )
    return replace(training, points=none, near=training.far * 1.5, far=training.far * 6)


SPOILED: dict[str, Callable[[TrainingSet], TrainingSet]] = {
    "as given": lambda training: training,
    "OpenCV axes": _posed(lambda m: FLIP @ m),
    "inverse": _posed(torch.linalg.inv),
    "mirrored": _posed(_mirrored),
    "upside down": _turned(2),
    "sideways": _turned(1),
    "renamed": _renamed,
    "depth bounds": _farther,
}


def main(data: Path, names: list[str]) -> None:
    print(f"| scene, views | {' | '.join(SPOILED)} | seconds |")
    print("|---|" + "---:|" * (len(SPOILED) + 1))
    alarms = misses = sound = spoiled = 0
    for name, loader in SCENES.items():
        if names and name not in names:
            continue
        for n_views in VIEWS:
            options = {"name": loader, "path": str(data / name), "n_views": n_views}
            if n_views == "all" and loader != "llff":
                options["split"] = "none"
            if loader == "mip360":
                options["images"], options["downscale"] = "images_4", 2
            try:
                training = registry.part("scene", options).load().training
            except UserError as error:
                print(f"| {name} {n_views} | {error} |", file=sys.stderr)
                continue
            cells, seconds = [], 0.0
            for kind, spoil in SPOILED.items():
                before = time.perf_counter()
                check = check_poses(spoil(training))
                seconds = seconds or time.perf_counter() - before
                if check is None:
                    cells.append("-")
                    continue
                wrong = check.fits != (kind == "as given")
                if kind == "as given":
                    sound, alarms = sound + 1, alarms + wrong
                    cells.append(f"{check.support:.2f}/{check.chance:.2f} ")
                else:
                    spoiled, misses = spoiled + 1, misses + wrong
                    cells.append("")
                cells[-1] += f"**{check.ratio:.2f}**" if wrong else f"{check.ratio:.2f}"
            count = len(training.views)
            print(
                f"| {name} {n_views} ({count}) | {' | '.join(cells)} | {seconds:.2f} |", flush=True
            )
    print(f"\nlimit {LIMIT}: {alarms} false alarms of {sound}, {misses} misses of {spoiled}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
