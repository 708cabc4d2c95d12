"""`scene=llff`: `poses_bounds.npy` beside `images_<factor>/`, as the LLFF data set comes.

A row of `poses_bounds.npy` holds a 3 x 5 matrix, row-major, and the near and far depth bounds. Its
columns are the camera's down, right and backward axes in the world, its centre, and (height, width,
focal) in pixels of the full-size photo (Mildenhall et al. 2019, LLFF's `poses/pose_utils.py`). Row
i belongs to the i-th image in sorted order. The principal point is the image's middle.

Sparse points come from the COLMAP model `sparse/0` where there is one (else there are none); it
must have the same poses. Near and far are the bounds of the training rows.
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

    from framework.scenes.assemble import Shot, Tracks
    from framework.types import Scene

NOT_ROTATION = 1e-3  # largest deviation of an axis' products from those of a rotation
SAME_POSE = 0.01  # distance between two models' camera centres, of the rig's size


@dataclass(frozen=True)
class Llff:
    """Options of `scene=llff`."""

    path: str
    n_views: int = 3
    factor: int = 8  # images_<factor> is read; 1 = images
    split: str = "llff"

    def __post_init__(self) -> None:
        check_folder_options("llff", self.path, self.n_views, self.split)
        require(
            self.factor >= 1,
            f"scene=llff: expected factor of at least 1, got {self.factor}; set scene.factor",
        )

    def load(self) -> Scene:
        """The scene. Raises UserError where the folder does not hold what the layout asks for."""
        from framework.scenes.assemble import assemble
        from framework.scenes.images import list_images, scene_folder

        folder = scene_folder("llff", self.path)
        files = list_images(folder / (f"images_{self.factor}" if self.factor > 1 else "images"))
        rows = _read_poses(folder / "poses_bounds.npy", files)
        names = [f.name for f in files]
        split = protocol(self.split).split(names, self.n_views, f"scene=llff: {folder}")
        shots = {i: _shot(files[i], rows[i], self.factor) for i in (*split.train, *split.test)}
        tracks = _tracks(folder, files, rows).for_training(split.train)
        bounds = rows[list(split.train), 15:]
        train, test = ([shots[i] for i in part] for part in (split.train, split.test))
        near, far = float(bounds[:, 0].min()), float(bounds[:, 1].max())
        return assemble(folder.resolve().name, self.split, train, test, tracks, near, far)


def _read_poses(path: Path, files: list[Path]) -> NDArray[np.float64]:
    """[n, 17] rows for n images. Raises UserError unless they are complete and sensible."""
    import numpy as np

    require(path.is_file(), f"{path}: expected LLFF poses, found no file; is scene.path right?")
    try:
        rows = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        raise UserError(f"{path}: expected a .npy array, got a damaged file; replace it") from None
    shape = "x".join(map(str, rows.shape))
    require(
        rows.ndim == 2 and rows.shape[1] == 17 and rows.dtype.kind in "fiu",
        f"{path}: expected an array of n x 17 numbers, got {shape} {rows.dtype}; replace it",
    )
    require(
        len(rows) == len(files),
        f"{path}: expected one row per image, got {len(rows)} rows and {len(files)} images in"
        f" {files[0].parent.name}; remove the surplus or restore what is missing",
    )
    rows = rows.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    require(not len(bad), f"{path}: expected finite numbers, got NaN or infinity in rows {bad}")
    good = (rows[:, 15] > 0) & (rows[:, 16] > rows[:, 15]) & (rows[:, [4, 9, 14]] > 0).all(axis=1)
    require(
        bool(good.all()),
        f"{path}: expected 0 < near < far and positive height, width, focal; got otherwise in rows"
        f" {np.flatnonzero(~good)}",
    )
    axes = rows[:, :15].reshape(-1, 3, 5)[:, :, :3]
    off = np.abs(axes.transpose(0, 2, 1) @ axes - np.eye(3)).max(axis=(1, 2)) > NOT_ROTATION
    require(
        not off.any() and bool((np.linalg.det(axes) > 0).all()),
        f"{path}: expected right-handed, orthonormal camera axes, got others; is it LLFF's layout?",
    )
    return rows


def _viewmat(row: NDArray[np.float64]) -> NDArray[np.float64]:
    """[4, 4] OpenCV world-to-camera of one row."""
    import numpy as np

    matrix = row[:15].reshape(3, 5)
    down, right, back, center = (matrix[:, k] for k in range(4))
    viewmat = np.eye(4)
    for k, axis in enumerate((right, down, -back)):
        viewmat[k, :3] = axis
        viewmat[k, 3] = -(axis * center).sum()
    return viewmat


def _shot(file: Path, row: NDArray[np.float64], factor: int) -> Shot:
    from framework.scenes.assemble import Shot, intrinsics
    from framework.scenes.images import read_image

    image = read_image(file)
    height, width = image.shape[:2]
    full_height, full_width, focal = row[4], row[9], row[14]
    require(
        abs(full_height / factor - height) < 1 and abs(full_width / factor - width) < 1,
        f"{file}: expected {full_width / factor:g}x{full_height / factor:g} pixels"
        f" ({full_width:g}x{full_height:g} by factor {factor}), got {width}x{height};"
        " correct scene.factor or resize the images",
    )
    fx, fy = focal * width / full_width, focal * height / full_height
    return Shot(file.name, _viewmat(row), intrinsics(fx, fy, width / 2, height / 2), image)


def _tracks(folder: Path, files: list[Path], rows: NDArray[np.float64]) -> Tracks:
    """The points of `sparse/0` with their tracks over the sorted images; none without a model."""
    import numpy as np

    from framework.scenes.assemble import Tracks
    from framework.scenes.colmap_model import read_model

    sparse = folder / "sparse" / "0"
    if not sparse.is_dir():
        return Tracks()
    model = read_model(sparse)
    stems = [Path(name).stem for name in model.names]
    if stems != [f.stem for f in files] and len(stems) != len(files):
        raise UserError(
            f"{sparse}: expected the {len(files)} images of poses_bounds.npy, got {len(stems)};"
            " remove the folder (then there are no sparse points) or rebuild the model"
        )
    theirs = np.array([-v[:3, :3].T @ v[:3, 3] for v in model.viewmats])
    ours = rows[:, :15].reshape(-1, 3, 5)[:, :, 3]
    size = np.linalg.norm(ours - ours.mean(axis=0), axis=1).max()
    away = np.linalg.norm(theirs - ours, axis=1).max()
    require(
        away <= SAME_POSE * size,
        f"{sparse}: expected the poses of poses_bounds.npy, got camera centres up to {away:.3g}"
        f" away (rig radius {size:.3g}); remove the folder or rebuild the model with these poses",
    )
    return model.tracks
