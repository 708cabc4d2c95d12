"""`scene=colmap`: photos and a COLMAP sparse model (`sparse/0` or `sparse`, bin or txt).

Cameras: PINHOLE, SIMPLE_PINHOLE, SIMPLE_RADIAL (its photos are undistorted to a pinhole of the same
focal length; pixels that the lens did not see get mask 0). Photos may be the model's size or that
times or over an integer, rounded (`images_4`); K is scaled by the exact ratio of the sizes.
Near and far are the 0.1 and 99.9 percentiles, as in LLFF, of the depths at which the training views
see points; they count every point with a training view in its track.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.scenes.options import check_folder_options
from framework.scenes.splits import protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.scenes.assemble import Shot
    from framework.scenes.colmap_model import Lens, Model
    from framework.types import Scene

PERCENTILES = (0.1, 99.9)


@dataclass(frozen=True)
class Colmap:
    """Options of `scene=colmap`."""

    path: str
    n_views: int = 12
    images: str = "images"  # folder of the photos inside path
    split: str = "llff"

    def __post_init__(self) -> None:
        check_folder_options("colmap", self.path, self.n_views, self.split)

    def load(self) -> Scene:
        """The scene. Raises UserError where folder, model and photos do not fit together."""
        from framework.scenes.assemble import assemble
        from framework.scenes.colmap_model import find_model, read_model
        from framework.scenes.images import list_images, scene_folder

        folder = scene_folder("colmap", self.path)
        list_images(folder / self.images)
        model = read_model(find_model(folder))
        where = f"scene=colmap: {folder}"
        split = protocol(self.split).split(model.names, self.n_views, where)
        files = _files(folder / self.images, model)
        train, test = (
            [_shot(files[i], model.names[i], model.lenses[i], model.viewmats[i]) for i in part]
            for part in (split.train, split.test)
        )
        near, far = _bounds(model, split.train, where)
        tracks = model.tracks.for_training(split.train)
        return assemble(folder.resolve().name, self.split, train, test, tracks, near, far)


def _files(folder: Path, model: Model) -> list[Path]:
    """The photo of each image of the model, by name."""
    files = [folder / name for name in model.names]
    missing = [f.name for f in files if not f.is_file()]
    require(
        not missing,
        f"{folder}: expected the {len(files)} images of the model, {len(missing)} missing (first:"
        f" {missing[0] if missing else ''}); restore them or choose another scene.images",
    )
    return files


def _shot(file: Path, name: str, lens: Lens, viewmat: NDArray[np.float64]) -> Shot:
    from framework.scenes.assemble import Shot, intrinsics
    from framework.scenes.images import read_image, resize_ratio

    image = read_image(file)
    height, width = image.shape[:2]
    sx, sy = resize_ratio(lens.width, width), resize_ratio(lens.height, height)
    if sx is None or sy is None or max(sx, sy) > 1.1 * min(sx, sy):
        raise UserError(
            f"{file}: expected the camera's {lens.width}x{lens.height} pixels or that times or over"
            f" an integer, got {width}x{height}; resize the images or choose another scene.images"
        )
    K = intrinsics(lens.fx * sx, lens.fy * sy, lens.cx * sx, lens.cy * sy)
    mask = None
    if lens.k != 0.0:
        image, mask = undistort(image, K, lens.k)
    return Shot(name, viewmat, K, image, mask=mask)


def undistort(
    image: NDArray[np.uint8], K: NDArray[np.float64], k: float
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """The photo as a pinhole K would have taken it, bilinear; and the mask of its valid pixels,
    None if all are. SIMPLE_RADIAL: x_distorted = x (1 + k |x|^2), x in units of
    the focal length, from the principal point."""
    import cv2
    import numpy as np

    height, width = image.shape[:2]
    x = (np.arange(width) + 0.5 - K[0, 2]) / K[0, 0]
    y = ((np.arange(height) + 0.5 - K[1, 2]) / K[1, 1])[:, None]
    factor = 1.0 + k * (x * x + y * y)
    # OpenCV counts pixel centres from 0, this project from 0.5
    u = K[0, 0] * x * factor + K[0, 2] - 0.5
    v = K[1, 1] * y * factor + K[1, 2] - 0.5
    straight = cv2.remap(
        image,
        u.astype(np.float32),
        v.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    # a pixel's own area reaches half a pixel beyond the outermost centres
    valid = (u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5)
    out = np.ascontiguousarray(straight, dtype=np.uint8)
    return out, None if valid.all() else valid.astype(np.float32)


def _bounds(model: Model, train: tuple[int, ...], where: str) -> tuple[float, float]:
    """Near and far over the training views."""
    import numpy as np

    depths = []
    for i in train:
        xyz, viewmat = model.tracks.xyz[model.tracks.seen[:, i]], model.viewmats[i]
        depths.append(xyz @ viewmat[2, :3] + viewmat[2, 3])
    z = np.concatenate(depths)
    z = z[z > 0]
    if not len(z):
        raise UserError(
            f"{where}: expected 3D points seen by the training views, got none, so that"
            " depth bounds are unknown; triangulate points or choose other views"
        )
    near, far = np.percentile(z, PERCENTILES)
    return float(near), float(max(far, near * (1 + 1e-6)))
