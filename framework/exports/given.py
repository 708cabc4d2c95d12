"""Cameras from a file, without photos: `cameras.json` as 3DGS (Kerbl et al. 2023) writes it, or
`transforms.json` as instant-ngp and nerfstudio read it (see `framework.records.cameras`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framework.errors import UserError, require
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES

if TYPE_CHECKING:
    from framework.scenes.lens import Lens
    from framework.types import Camera

MOST = 100_000  # cameras


@dataclass(frozen=True)
class Given:
    """A camera with its name. bent: its lens is no pinhole, which the camera leaves out."""

    name: str
    camera: Camera
    bent: bool = False


def read_given(path: Path) -> list[Given]:
    """The cameras in the file's order. Raises UserError for a file of another kind or content."""
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


def _from_transforms(path: Path) -> list[Given]:
    from framework.scenes.transforms_file import read_cameras

    found = []
    for frame in read_cameras(path):
        require(
            "w" in frame.values and "h" in frame.values,
            f"{frame.where}: expected w and h, the size of the picture in pixels, got none; add"
            " them to the file",
        )
        lens = frame.lens(0, 0)
        found.append(Given(frame.name, _camera(frame.viewmat, lens), any(lens.distortion.terms)))
    return found


def _listed(entry: Mapping[str, Any], where: str) -> Given:
    """An entry of `cameras.json`: the principal point is the middle, which the file cannot tell."""
    import numpy as np

    from framework.scenes.cameras import checked_lens, checked_pose
    from framework.scenes.lens import Lens

    to_world = _numbers(entry, "rotation", (3, 3), where)
    viewmat = np.eye(4)
    viewmat[:3, :3] = to_world.T
    with np.errstate(over="ignore", invalid="ignore"):  # refused in the next lines
        viewmat[:3, 3] = -to_world.T @ _numbers(entry, "position", (3,), where)
    checked_pose(viewmat, where)
    width, height, fx, fy = (
        float(_numbers(entry, key, (), where)) for key in ("width", "height", "fx", "fy")
    )
    lens = Lens(round(width), round(height), fx, fy, width / 2, height / 2)
    name = entry.get("img_name", entry.get("id", where))
    return Given(str(name), _camera(viewmat, checked_lens(lens, where)))


def _numbers(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> Any:
    """A float64 array of this shape."""
    import numpy as np

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

    from framework.files.limits import check_pixels
    from framework.types import Camera

    check_pixels("camera", lens.width, lens.height)
    K = [[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]
    return Camera(
        torch.from_numpy(viewmat), torch.tensor(K, dtype=torch.float64), lens.width, lens.height
    )
