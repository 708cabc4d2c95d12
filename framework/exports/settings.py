"""`settings.json`: the first view and the background of a model, as PlayCanvas' SuperSplat viewer
reads them (version 1 of its settings, which later ones read too). Splat files have no place for
either; a splat PLY of ours has the background in a comment of its header.

That viewer turns what it opens by half a turn about z, so that y points up; positions are given
after that. Its camera cannot roll.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from framework.exports.rig import Array, rig

if TYPE_CHECKING:
    from framework.types import Camera

SETTINGS = "settings.json"


def settings(cameras: Sequence[Camera], background: Sequence[float], distance: float) -> str:
    """The file's content. cameras: of the training views, in the model's world; the one nearest to
    their mean sees the first picture. distance: from it to the point it turns around."""
    stood = rig(cameras)
    away = np.linalg.norm(stood.centers - stood.centers.mean(axis=0), axis=1)
    first = int(away.argmin())
    camera, center = cameras[first], stood.centers[first]
    longer = max(camera.width, camera.height)  # the viewer takes it for the window's longer side
    fov = 2 * math.atan(longer / (2 * float(camera.K[0, 0])))
    content: dict[str, Any] = {
        "camera": {
            "fov": math.degrees(fov),
            "position": _seen(center),
            "target": _seen(center + distance * stood.forward[first]),
            "startAnim": "none",
            "animTrack": None,
        },
        "background": {"color": [min(max(float(c), 0.0), 1.0) for c in background]},
        "animTracks": [],
    }
    return json.dumps(content, indent=1)


def _seen(point: Array) -> list[float]:
    """In the viewer's world."""
    x, y, z = (float(value) for value in point)
    return [-x, -y, z]
