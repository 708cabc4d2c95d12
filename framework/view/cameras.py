"""The cameras of a run from its `transforms.json` (see `framework.records.cameras`).

Not read by `framework.scenes`, which would import numba.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import RUN_BYTES
from framework.records.cameras import NEAR, TRANSFORMS
from framework.scenes.cameras import checked_lens, checked_pose
from framework.scenes.lens import Lens

INTRINSICS = ("w", "h", "fl_x", "fl_y", "cx", "cy")
LARGEST = 1e12  # of a number in the file; far beyond any camera


@dataclass(frozen=True)
class RunCamera:
    """A camera of a run.

    Attributes:
        tests: whether it is a test view.
        viewmat: [4, 4] OpenCV world-to-camera.
        lens: in pixels of the pictures that the run used.
        exposure: [3] factors of the photo's colours to those of the model.
    """

    name: str
    tests: bool
    viewmat: NDArray[np.float64]
    lens: Lens
    exposure: tuple[float, ...] = (1.0, 1.0, 1.0)

    @property
    def center(self) -> NDArray[np.float64]:
        """[3] in the world."""
        return np.asarray(-self.viewmat[:3, :3].T @ self.viewmat[:3, 3])


def read_cameras(run_dir: Path) -> tuple[tuple[RunCamera, ...], float]:
    """Read the cameras, test views first, and the depth where rendering begins.

    Raises:
        UserError: if the file is missing or was not written by a run.
    """
    path = run_dir / TRANSFORMS
    content = read_json(path, RUN_BYTES)
    frames = content.get("frames") if isinstance(content, Mapping) else None
    if not isinstance(frames, list):
        raise UserError(f"{path}: expected a list 'frames' of cameras, got none; run again")
    test = content.get("test_filenames", [])
    _check(path, isinstance(test, list), "a list 'test_filenames'", test)
    near = content.get("near_plane", NEAR)
    _check(path, _is_number(near) and near > 0, "a positive near_plane", near)
    cameras = [_camera(path, i, frame, test) for i, frame in enumerate(frames)]
    names = {camera.name for camera in cameras}
    _check(path, len(names) == len(cameras), "each camera once", f"{len(names)} names")
    return tuple(sorted(cameras, key=lambda camera: not camera.tests)), float(near)


def _camera(path: Path, number: int, frame: Any, test: Sequence[Any]) -> RunCamera:
    where = f"{path}: frame {number}"
    _check(where, isinstance(frame, Mapping), "an object", frame)
    name, matrix = frame.get("file_path"), frame.get("transform_matrix")
    _check(where, isinstance(name, str) and name.strip(), "a file_path", name)
    rows = isinstance(matrix, list) and len(matrix) == 4
    rows = rows and all(isinstance(row, list) and len(row) == 4 for row in matrix)
    _check(where, rows and all(_is_number(v) for row in matrix for v in row), "4x4 numbers", matrix)
    values = [frame.get(key) for key in INTRINSICS]
    _check(where, all(map(_is_number, values)), f"numbers {', '.join(INTRINSICS)}", values)
    width, height, fx, fy, cx, cy = values
    _check(where, width == int(width) and height == int(height), "whole pixels", values[:2])
    to_world = np.array(matrix, dtype=np.float64)
    to_world[:3, 1:3] *= -1  # up and backward become down and forward
    viewmat = np.eye(4)
    viewmat[:3, :3] = to_world[:3, :3].T
    viewmat[:3, 3] = -to_world[:3, :3].T @ to_world[:3, 3]
    lens = checked_lens(Lens(int(width), int(height), fx, fy, cx, cy), where)
    exposure = frame.get("exposure", [1.0, 1.0, 1.0])
    fits = isinstance(exposure, list) and len(exposure) == 3 and all(map(_is_number, exposure))
    _check(where, fits and min(exposure) > 0, "3 positive numbers as exposure", exposure)
    pose = checked_pose(viewmat, where)
    return RunCamera(name, name in test, pose, lens, tuple(map(float, exposure)))


def upward(cameras: Sequence[RunCamera]) -> list[float]:
    """[3] unit vector: the mean up direction of the cameras."""
    total = sum((-camera.viewmat[1, :3] for camera in cameras), np.zeros(3))
    length = float(np.linalg.norm(total))
    return [0.0, -1.0, 0.0] if length < 1e-3 else [float(v) for v in total / length]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST


def _check(where: object, good: object, expected: str, got: object) -> None:
    require(bool(good), f"{where}: expected {expected}, got {str(got)[:80]!r}; run again")
