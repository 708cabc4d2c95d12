"""`scene=llff`: `poses_bounds.npy` and `images_8/`, the layout of the LLFF data set.

A row of `poses_bounds.npy` is a 3 x 5 matrix, row-major, and the near and far depth bounds. The
first columns of the matrix are the camera's down, right and backward axes in the world. Then come
its centre, and (height, width, focal) in pixels of the full-size photo (Mildenhall et al. 2019,
LLFF's `poses/pose_utils.py`). Row i belongs to the i-th image in sorted order. The principal point
is the middle of the image. Photos may have any size of these proportions, rounded (`images_4`).

The poses were estimated with a lens (COLMAP's SIMPLE_RADIAL) whose distortion is not in the layout
and which the usual evaluation ignores. `k1` removes it from the photos, also from test photos.

Sparse points come from the COLMAP model in `sparse/0`, if there is one with the same poses. Near
and far are the bounds of the training rows, unless given.

If there are more or fewer photos than rows, the model that has the rows' poses shows which photo a
row belongs to. Without such a model the folder is refused.
"""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, check_option, require
from framework.files.arrays import read_npy
from framework.files.limits import SIDE_PIXELS
from framework.files.opened import is_file
from framework.scenes.cameras import checked_lens, checked_pose
from framework.scenes.conventions import decoded_as
from framework.scenes.images import EIGHTH_OR_FULL, list_images, photo_folder
from framework.scenes.layout import FolderScene, Listing
from framework.scenes.lens import Distortion, Lens
from framework.scenes.listed import find_photos, warn_unplaced
from framework.scenes.masks import find_masks
from framework.scenes.model_points import colmap_tracks, same_poses
from framework.scenes.photo import Photo
from framework.scenes.splits import protocol

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Llff(FolderScene):
    """Options of `scene=llff`.

    Attributes:
        near, far: depth bounds in scene units; null = from the file.
    """

    layout: ClassVar[str] = "llff"

    n_views: int | str = 3  # training views; all = every one that is not for testing
    images: str = "auto"  # folder of the photos; auto = images_8 where there is one, else images
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    k1: float = 0.0  # radial distortion to remove, x (1 + k1 r^2); 0 = none, as is usual
    poses: str = "llff_c2w"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def __post_init__(self) -> None:
        super().__post_init__()
        expected = "COLMAP's SIMPLE_RADIAL distortion in (-1, 1), 0 for none"
        check_option(self, "scene", "k1", -1 < self.k1 < 1, expected)

    def listing(self, folder: Path) -> Listing:
        source, where = folder / "poses_bounds.npy", f"scene=llff: {folder}"
        photos = photo_folder("llff", folder, self.images, EIGHTH_OR_FULL, source.name)
        rows = _read_poses(source)
        viewmats = [_viewmat(row, f"{source}: row {i}") for i, row in enumerate(rows)]
        viewmats = [decoded_as(viewmat, Llff.poses, self.poses) for viewmat in viewmats]
        row_names, files = self._pair(folder, photos, viewmats)
        names, viewmats = [row_names[i] for i in files], [viewmats[i] for i in files]
        lenses = [_lens(rows[i], self.k1, f"{source}: row {i}") for i in files]
        masks = find_masks(folder, photos.name, names)
        split = protocol(self.split).split(names, self.n_views, where)
        bounds = rows[[*files]][list(split.train), 15:]
        return Listing(
            folder.resolve().name,
            where,
            viewmats,
            [*map(Photo, files.values(), names, lenses, viewmats, masks)].__getitem__,
            split,
            colmap_tracks(folder, source.name, names, viewmats, self.model),
            float(bounds[:, 0].min()) if self.near is None else self.near,
            float(bounds[:, 1].max()) if self.far is None else self.far,
        )

    def _pair(
        self, folder: Path, photos: Path, viewmats: Sequence[NDArray[np.float64]]
    ) -> tuple[list[str], dict[int, Path]]:
        """The name of each row's photo, and the photos that exist by their row's index."""
        files = list_images(photos)
        if len(files) == len(viewmats):
            _warn_of_numbers(files)
            return [file.name for file in files], dict(enumerate(files))
        names = same_poses(folder, viewmats, self.model)
        if names is None:
            raise UserError(
                f"{folder / 'poses_bounds.npy'}: expected one row per image, got"
                f" {len(viewmats)} rows and {len(files)} images in {photos.name}; remove the"
                " surplus or restore what is missing"
            )
        matched = find_photos(photos, names, str(photos))
        warn_unplaced(photos, matched.values())
        return names, matched


def _warn_of_numbers(files: list[Path]) -> None:
    """Log a warning if the numbers in the names of sorted files are in another order."""

    def by_number(file: Path) -> list[int | str]:
        parts = re.split(r"(\d+)", file.name)
        return [int(part) if k % 2 else part for k, part in enumerate(parts)]

    natural = sorted(files, key=by_number)
    if natural != files:
        pairs = zip(files, natural, strict=True)
        first, second = next(pair for pair in pairs if pair[0] != pair[1])
        log.warning(
            f"{files[0].parent}: row i of poses_bounds.npy is taken as that of the i-th photo in"
            f" alphabetical order, in which {first.name} comes before {second.name}; if the poses"
            " are in the order of the numbers, they do not fit: give all numbers in the names"
            " equally many digits"
        )


def _read_poses(path: Path) -> NDArray[np.float64]:
    """[n, 17] rows. Raises UserError unless they are complete and plausible."""
    require(is_file(path), f"{path}: expected LLFF poses, found no file; is scene.path right?")
    rows = read_npy(path)
    shape = "x".join(map(str, rows.shape))
    require(
        rows.ndim == 2 and rows.shape[1] == 17 and rows.dtype.kind in "fiu",
        f"{path}: expected an array of n x 17 numbers, got {shape} {rows.dtype}; replace it",
    )
    rows = rows.astype(np.float64)
    sides = rows[:, [4, 9]]
    good = np.isfinite(rows).all(axis=1)
    good &= (rows[:, 15] > 0) & (rows[:, 16] > rows[:, 15]) & (rows[:, 14] > 0)
    good &= ((sides >= 1) & (sides <= SIDE_PIXELS)).all(axis=1)
    require(
        bool(good.all()),
        f"{path}: expected finite numbers, 0 < near < far, positive focal and sides of 1 to"
        f" {SIDE_PIXELS} pixels; got otherwise in rows {np.flatnonzero(~good)}; replace it",
    )
    return rows


def _viewmat(row: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """[4, 4] OpenCV world-to-camera of one row."""
    matrix = row[:15].reshape(3, 5)
    down, right, back, center = (matrix[:, k] for k in range(4))
    viewmat = np.eye(4)
    for k, axis in enumerate((right, down, -back)):
        viewmat[k, :3] = axis
        viewmat[k, 3] = -(axis * center).sum()
    return checked_pose(viewmat, where)


def _lens(row: NDArray[np.float64], k1: float, where: str) -> Lens:
    """The camera of a full-size photo."""
    height, width, focal = round(row[4]), round(row[9]), float(row[14])
    lens = Lens(width, height, focal, focal, width / 2, height / 2, Distortion(k1))
    return checked_lens(lens, where)
