"""The cameras of a run next to its `point_cloud.ply`, for viewers and other trainers.

`cameras.json` is as 3DGS (Kerbl et al. 2023) writes it: a list of id, img_name, width, height,
position [3], rotation [3, 3], fy and fx in pixels. Rotations are camera to world with axes right,
down, forward; test views come first. `transforms.json` is as instant-ngp and nerfstudio read it:
per photo its camera-to-world matrix with axes right, up, backward, and intrinsics in pixels. It
lists the training and the test photos, and `near_plane`, the depth where renders begin. Intrinsics
are those of the pictures that the run used: undistorted and reduced.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from framework.files.whole import write_whole

if TYPE_CHECKING:
    from framework.types import Camera

CAMERAS, TRANSFORMS = "cameras.json", "transforms.json"


class Shot(Protocol):
    """A view, or a camera with a name."""

    @property
    def name(self) -> str: ...

    @property
    def camera(self) -> Camera: ...


def write_cameras(
    folder: Path,
    training: Sequence[Shot],
    test: Sequence[Shot],
    near: float,
    exposure: Callable[[Camera], list[float]] | None = None,
) -> None:
    """Write both files into `folder`.

    Args:
        near: depth in scene units, where the renders begin.
        exposure: of a camera, the factors [3] of its photo's colours to those of the model.
    """
    listed = [_listed(number, view) for number, view in enumerate([*test, *training])]
    write_whole(folder / CAMERAS, json.dumps(listed))
    transforms: dict[str, Any] = {
        "camera_model": "PINHOLE",
        "train_filenames": [view.name for view in training],
        "val_filenames": [view.name for view in test],  # nerfstudio wants both
        "test_filenames": [view.name for view in test],
        "frames": [_frame(view) for view in [*training, *test]],
        "near_plane": near,
    }
    if exposure is not None:
        for frame, view in zip(transforms["frames"], [*training, *test], strict=True):
            frame["exposure"] = exposure(view.camera)
    write_whole(folder / TRANSFORMS, json.dumps(transforms))


def _listed(number: int, view: Shot) -> dict[str, Any]:
    """An entry of `cameras.json`."""
    camera = view.camera
    return {
        "id": number,
        "img_name": view.name,
        "width": camera.width,
        "height": camera.height,
        "position": camera.center.tolist(),
        "rotation": camera.viewmat[:3, :3].T.tolist(),
        "fy": float(camera.K[1, 1]),
        "fx": float(camera.K[0, 0]),
    }


def _frame(view: Shot) -> dict[str, Any]:
    """An entry of `transforms.json`."""
    camera = view.camera
    to_world = camera.viewmat.inverse()
    to_world[:, 1:3] *= -1  # the axes down and forward become up and backward
    return {
        "file_path": view.name,
        "transform_matrix": to_world.tolist(),
        "fl_x": float(camera.K[0, 0]),
        "fl_y": float(camera.K[1, 1]),
        "cx": float(camera.K[0, 2]),
        "cy": float(camera.K[1, 2]),
        "w": camera.width,
        "h": camera.height,
    }
