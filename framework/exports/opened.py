"""Opens a finished run for rendering: its Gaussians, background and cameras.

Cameras are in a `cameras.json` as 3DGS (Kerbl et al. 2023) writes it, or in a `transforms.json` of
instant-ngp and nerfstudio (see `framework.records.cameras`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES, check_pixels
from framework.files.opened import is_file
from framework.records.cameras import NEAR, TRANSFORMS
from framework.records.record import PLY
from framework.scenes.cameras import checked_lens, checked_pose
from framework.scenes.lens import Lens
from framework.scenes.transforms_file import read_cameras

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians, Render

MOST = 100_000  # cameras


@dataclass(frozen=True)
class NamedCamera:
    """distorted: the file also gives a lens distortion, which `camera` does not have."""

    name: str
    camera: Camera
    distorted: bool = False


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

    path = folder / TRANSFORMS
    require(
        is_file(folder / PLY) and is_file(path),
        f"{folder}: expected the folder of a finished run, with {PLY} and {TRANSFORMS}, found none;"
        " a study's runs are in reports/STUDY/runs/NAME",
    )
    content = read_json(path, TEXT_BYTES)
    require(isinstance(content, dict), f"{path}: expected a run's cameras, got a list; train again")
    cameras = read_named_cameras(path)
    near = content.get("near_plane", NEAR)
    right = isinstance(near, int | float) and not isinstance(near, bool) and 0 < near < 1e9
    require(right, f"{path}: expected a positive near_plane, got {near!r:.80}")
    names = content.get("train_filenames")
    names = names if isinstance(names, list) else []
    training = tuple(named for named in cameras if named.name in names) or tuple(cameras)
    gaussians, background = read_ply(folder / PLY)
    require(len(gaussians) > 0, f"{folder / PLY}: expected Gaussians, got none; train again")
    if background is None:
        background = torch.zeros(3)
    return OpenedRun(folder, gaussians, background, training, float(near))


def read_named_cameras(path: Path) -> list[NamedCamera]:
    """Read cameras in the file's order.

    Raises:
        UserError: for another kind of file.
    """
    content = read_json(path, TEXT_BYTES)
    if isinstance(content, dict) and "frames" in content:
        return _from_transforms(path)
    if isinstance(content, list) and content and all(isinstance(entry, dict) for entry in content):
        require(len(content) <= MOST, f"{path}: expected at most {MOST:,} cameras; use fewer")
        return [_listed(entry, f"{path}: camera {n}") for n, entry in enumerate(content)]
    raise UserError(
        f"{path}: expected cameras, a cameras.json as 3DGS writes it or a transforms.json, got"
        " neither; a run's folder has both"
    )


def _from_transforms(path: Path) -> list[NamedCamera]:
    cameras = []
    for frame in read_cameras(path):
        require(
            "w" in frame.values and "h" in frame.values,
            f"{frame.where}: expected w and h, the size of the picture in pixels, got none; add"
            " them to the file",
        )
        lens = frame.lens(0, 0)
        cameras.append(
            NamedCamera(frame.name, _camera(frame.viewmat, lens), any(lens.distortion.terms))
        )
    return cameras


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
    return NamedCamera(str(name), _camera(viewmat, checked_lens(lens, where)))


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


def _camera(viewmat: Any, lens: Lens) -> Camera:
    import torch

    from framework.types import Camera

    check_pixels("camera", lens.width, lens.height)
    K = [[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]
    return Camera(
        torch.from_numpy(viewmat), torch.tensor(K, dtype=torch.float64), lens.width, lens.height
    )
