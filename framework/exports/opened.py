"""Opens a finished run for rendering: its Gaussians, background and cameras.

Cameras are in a `cameras.json` as 3DGS (Kerbl et al. 2023) writes it, or in a `transforms.json` of
instant-ngp and nerfstudio (see `framework.records.cameras`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES, check_pixels
from framework.files.opened import is_file
from framework.records.cameras import TRANSFORMS
from framework.records.record import PLY
from framework.scenes.cameras import center_of, checked_lens, checked_pose
from framework.scenes.lens import Lens
from framework.scenes.transforms_file import Frame, read_cameras

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians, Render

LARGEST = 1e12  # of a number in the file; far beyond any camera


@dataclass(frozen=True)
class NamedCamera:
    """A camera of a file.

    Attributes:
        viewmat: [4, 4] OpenCV world-to-camera.
        lens: in pixels; a distortion is not part of `camera`.
        exposure: [3] factors of the photo's colours to those of the model.
        tests: whether it is a test view.
    """

    name: str
    viewmat: NDArray[np.float64]
    lens: Lens
    exposure: tuple[float, ...] = (1.0, 1.0, 1.0)
    tests: bool = False

    @property
    def center(self) -> NDArray[np.float64]:
        """[3] in the world."""
        return center_of(self.viewmat)

    @property
    def distorted(self) -> bool:
        """Whether the file gives a lens distortion."""
        return any(self.lens.distortion.terms)

    @cached_property
    def camera(self) -> Camera:
        """The pinhole camera."""
        import torch

        from framework.types import Camera

        lens = self.lens
        K = [[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]
        intrinsics = torch.tensor(K, dtype=torch.float64)
        return Camera(torch.from_numpy(self.viewmat), intrinsics, lens.width, lens.height)


@dataclass(frozen=True)
class RunCameras:
    """The `transforms.json` of a run.

    Attributes:
        cameras: in the file's order.
        training, test: names of the photos.
        near: depth where rendering begins.
    """

    cameras: tuple[NamedCamera, ...]
    training: tuple[str, ...]
    test: tuple[str, ...]
    near: float


@dataclass(frozen=True)
class OpenedRun:
    """background: [3]. cameras: of the training views. near: depth where rendering begins."""

    folder: Path
    gaussians: Gaussians
    background: Tensor
    cameras: tuple[NamedCamera, ...]
    near: float

    def render(self, camera: Camera, depth: bool = False) -> Render:
        """Render the Gaussians from `camera`."""
        from framework.kernels import rasterize

        return rasterize(
            self.gaussians, camera, background=self.background, near=self.near, depth=depth
        )


def open_run(folder: Path) -> OpenedRun:
    """Read a run.

    Raises:
        UserError: unless `folder` is that of a finished run.
    """
    import torch

    from framework.records.ply import read_ply

    require(
        is_file(folder / PLY) and is_file(folder / TRANSFORMS),
        f"{folder}: expected the folder of a finished run, with {PLY} and {TRANSFORMS}, found none;"
        " a study's runs are in reports/STUDY/runs/NAME",
    )
    read = read_run_cameras(folder)
    training = tuple(c for c in read.cameras if c.name in read.training) or read.cameras
    gaussians, background = read_ply(folder / PLY)
    require(len(gaussians) > 0, f"{folder / PLY}: expected Gaussians, got none; train again")
    if background is None:
        background = torch.zeros(3)
    return OpenedRun(folder, gaussians, background, training, read.near)


def read_run_cameras(folder: Path) -> RunCameras:
    """Read the cameras of a run, without torch.

    Raises:
        UserError: if the file is missing or was not written by a run.
    """
    path = folder / TRANSFORMS
    frames = read_cameras(path)
    content = read_json(path, TEXT_BYTES)
    near = content.get("near_plane")
    _check(path, _is_number(near) and near > 0, "a positive near_plane", near)
    training, test = (content.get(f"{kind}_filenames") for kind in ("train", "test"))
    for names in (training, test):
        fits = isinstance(names, list) and all(isinstance(name, str) for name in names)
        _check(path, fits, "names of photos", names)
    cameras = tuple(_of_frame(frame, test) for frame in frames)
    return RunCameras(cameras, tuple(training), tuple(test), float(near))


def read_named_cameras(path: Path) -> list[NamedCamera]:
    """Read cameras in the file's order.

    Raises:
        UserError: for another kind of file.
    """
    content = read_json(path, TEXT_BYTES)
    if isinstance(content, dict) and "frames" in content:
        return [_of_frame(frame) for frame in read_cameras(path)]
    if isinstance(content, list) and content and all(isinstance(entry, dict) for entry in content):
        return [_listed(entry, f"{path}: camera {n}") for n, entry in enumerate(content)]
    raise UserError(
        f"{path}: expected cameras, a cameras.json as 3DGS writes it or a transforms.json, got"
        " neither; a run's folder has both"
    )


def _of_frame(frame: Frame, test: Collection[str] = ()) -> NamedCamera:
    sides = [frame.values.get(side) for side in ("w", "h")]
    _check(frame.where, None not in sides, "w and h, the size of the picture in pixels", sides)
    exposure = frame.entry.get("exposure", [1.0, 1.0, 1.0])
    fits = isinstance(exposure, list) and len(exposure) == 3 and all(map(_is_number, exposure))
    _check(frame.where, fits and min(exposure) > 0, "an exposure of 3 positive numbers", exposure)
    lens = frame.lens(0, 0)
    check_pixels(frame.where, lens.width, lens.height)
    factors = tuple(map(float, exposure))
    return NamedCamera(frame.name, frame.viewmat, lens, factors, frame.name in test)


def _listed(entry: Mapping[str, Any], where: str) -> NamedCamera:
    """An entry of `cameras.json`, whose principal point is the middle."""
    to_world = _numbers(entry, "rotation", (3, 3), where)
    viewmat = np.eye(4)
    viewmat[:3, :3] = to_world.T
    with np.errstate(over="ignore", invalid="ignore"):  # refused by checked_pose
        viewmat[:3, 3] = -to_world.T @ _numbers(entry, "position", (3,), where)
    checked_pose(viewmat, where)
    width, height, fx, fy = (
        float(_numbers(entry, key, (), where)) for key in ("width", "height", "fx", "fy")
    )
    lens = Lens(round(width), round(height), fx, fy, width / 2, height / 2)
    name = entry.get("img_name", entry.get("id", where))
    checked_lens(lens, where)
    check_pixels(where, lens.width, lens.height)
    return NamedCamera(str(name), viewmat, lens)


def _numbers(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Any:
    """A float64 array of this shape."""
    try:
        array = np.array(entry.get(key), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    size = "x".join(map(str, shape)) or "one"
    require(
        array.shape == shape and bool(np.isfinite(array).all()),
        f"{where}: expected {key}, {size} number{'s' if shape else ''}, got"
        f" {repr(entry[key])[:80] if key in entry else 'none'}; correct the file",
    )
    return array


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) <= LARGEST


def _check(where: object, good: object, expected: str, got: object) -> None:
    require(bool(good), f"{where}: expected {expected}, got {str(got)[:80]!r}; run again")
