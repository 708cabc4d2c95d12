"""The cameras of a run from its `transforms.json` (see `framework.records.cameras`)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import require
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.records.cameras import NEAR, TRANSFORMS
from framework.scenes import transforms_file
from framework.scenes.cameras import center_of
from framework.scenes.lens import Lens
from framework.scenes.transforms_file import Frame

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
        return center_of(self.viewmat)


def read_cameras(run_dir: Path) -> tuple[tuple[RunCamera, ...], float]:
    """Read the cameras, test views first, and the depth where rendering begins.

    Raises:
        UserError: if the file is missing or was not written by a run.
    """
    path = run_dir / TRANSFORMS
    frames = transforms_file.read_cameras(path)
    content = read_json(path, TEXT_BYTES)
    test, near = content.get("test_filenames", []), content.get("near_plane", NEAR)
    _check(path, isinstance(test, list), "a list 'test_filenames'", test)
    _check(path, _is_number(near) and near > 0, "a positive near_plane", near)
    cameras = [_camera(frame, test) for frame in frames]
    return tuple(sorted(cameras, key=lambda camera: not camera.tests)), float(near)


def _camera(frame: Frame, test: Sequence[Any]) -> RunCamera:
    sides = [frame.values.get(side) for side in ("w", "h")]
    _check(frame.where, None not in sides, "w and h in pixels", sides)
    exposure = frame.entry.get("exposure", [1.0, 1.0, 1.0])
    fits = isinstance(exposure, list) and len(exposure) == 3 and all(map(_is_number, exposure))
    _check(frame.where, fits and min(exposure) > 0, "3 positive numbers as exposure", exposure)
    return RunCamera(
        frame.name, frame.name in test, frame.viewmat, frame.lens(0, 0), (*map(float, exposure),)
    )


def upward(cameras: Sequence[RunCamera]) -> list[float]:
    """[3] unit vector: the mean up direction of the cameras."""
    total = sum((-camera.viewmat[1, :3] for camera in cameras), np.zeros(3))
    length = float(np.linalg.norm(total))
    return [0.0, -1.0, 0.0] if length < 1e-3 else [float(v) for v in total / length]


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST


def _check(where: object, good: object, expected: str, got: object) -> None:
    require(bool(good), f"{where}: expected {expected}, got {str(got)[:80]!r}; run again")
