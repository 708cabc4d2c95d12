"""`settings.json`: the first view and the background of a model, as PlayCanvas' SuperSplat viewer
reads them (version 1 of its settings, which later ones read too). Splat files have no place for
either; a splat PLY of ours has the background in a comment of its header.

That viewer turns what it opens by half a turn about z, so that y points up; positions are given
after that. Its camera cannot roll: a world in which y does not point down is seen tilted.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from framework.files.whole import write_whole

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, View

SETTINGS = "settings.json"
MIDDLE = 0.25  # of the picture's sides, left out at each edge


def write_settings(
    folder: Path, training: Sequence[View], means: Tensor, background: Tensor, near: float
) -> None:
    """Write `settings.json` into `folder`.

    Args:
        means: [M, 3] of the Gaussians.
        background: [3].
        near: depth in scene units, where the renders begin.
    """
    cameras = [view.camera for view in training]
    away = _ahead(cameras[_middle(cameras)], means, near)
    write_whole(folder / SETTINGS, settings(cameras, background.tolist(), away))


def settings(cameras: Sequence[Camera], background: Sequence[float], distance: float) -> str:
    """The file's content.

    Args:
        cameras: of the training views, in the model's world. The first view is that of the camera
            nearest to their mean.
        distance: from it to the point it turns around.
    """
    camera = cameras[_middle(cameras)]
    center, forward = camera.center.numpy(), camera.viewmat[2, :3].numpy()
    longer = max(camera.width, camera.height)  # the viewer takes it for the window's longer side
    fov = 2 * math.atan(longer / (2 * float(camera.K[0, 0])))
    content: dict[str, Any] = {
        "camera": {
            "fov": math.degrees(fov),
            "position": _seen(center),
            "target": _seen(center + distance * forward),
            "startAnim": "none",
            "animTrack": None,
        },
        "background": {"color": [min(max(float(c), 0.0), 1.0) for c in background]},
        "animTracks": [],
    }
    return json.dumps(content, indent=1)


def _middle(cameras: Sequence[Camera]) -> int:
    """Which one stands nearest to the mean."""
    centers = np.stack([camera.center.numpy() for camera in cameras])
    return int(np.linalg.norm(centers - centers.mean(axis=0), axis=1).argmin())


def _ahead(camera: Camera, means: Tensor, near: float) -> float:
    """Median depth of the Gaussians in the middle of the picture; 100 near planes for none."""
    seen = means.detach().cpu().double().numpy() @ camera.viewmat[:3, :3].double().numpy().T
    seen = seen + camera.viewmat[:3, 3].double().numpy()
    seen = seen[seen[:, 2] > near]
    at = (seen @ camera.K.double().numpy().T)[:, :2] / seen[:, 2:]
    side = np.array([camera.width, camera.height])
    inside = (at > MIDDLE * side).all(axis=1) & (at < (1 - MIDDLE) * side).all(axis=1)
    return float(np.median(seen[inside, 2])) if inside.any() else 100 * near


def _seen(point: NDArray[np.floating[Any]]) -> list[float]:
    """In the viewer's world."""
    x, y, z = (float(value) for value in point)
    return [-x, -y, z]
