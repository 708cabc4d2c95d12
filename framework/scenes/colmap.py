"""`scene=colmap`: photos and a COLMAP sparse model (bin or txt).

Among several models (`sparse/0`, `sparse/1`, `sparse`, nerfstudio's `colmap/sparse/0`), the one
with poses for most of the photos is used. Photos without a pose and poses without a photo are left
out.

Cameras: PINHOLE, SIMPLE_PINHOLE, and SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, whose photos are
undistorted to a pinhole of the same focal lengths (pixels outside the photo get mask 0). Photos may
have any size of the model's proportions, rounded (`images_4`). Near and far are the 0.1 and 99.9
percentiles, as in LLFF, of the depths of points in the training views; `points` handles models
without points or tracks. Pixels that are black in `masks/`, or transparent, do not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.options import check_folder_options
from framework.scenes.splits import protocol

if TYPE_CHECKING:
    from framework.scenes.colmap_model import Model
    from framework.types import Scene


@dataclass(frozen=True)
class Colmap:
    """Options of `scene=colmap`.

    Attributes:
        near, far: depth bounds in scene units; null = from the points.
    """

    path: str  # folder of the scene
    n_views: int | str = 12  # training views; all = every one that is not for testing
    images: str = "images"  # folder of the photos inside path
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    downscale: int = 1  # photos are reduced by it, averaging boxes of pixels
    near: float | None = None
    far: float | None = None
    split: str = "llff"  # which views train and which test: llff, mip360, dtu; none = no test
    poses: str = "opencv_w2c"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def __post_init__(self) -> None:
        check_folder_options("colmap", self)

    def load(self) -> Scene:
        """Load the scene.

        Raises:
            UserError: if folder, model and photos do not fit together.
        """
        from framework.scenes.images import scene_folder

        folder = scene_folder("colmap", self.path)
        return load_colmap("colmap", folder, inside(folder, self.images), self)


def load_colmap(
    loader: str,
    folder: Path,
    photos: Path,
    options: Colmap,
    name: str | None = None,
    masks: Path | None = None,
) -> Scene:
    """Load the scene of the model in `folder` and the images in `photos`, for `scene=<loader>`.

    Args:
        name: of the scene; default the folder's.
        masks: the folder that has `masks/`; default `folder`.
    """
    from framework.scenes.assemble import assemble
    from framework.scenes.conventions import decoded_as
    from framework.scenes.listed import find_photos, warn_unplaced
    from framework.scenes.masks import find_masks
    from framework.scenes.photo import Photo, read_shots
    from framework.scenes.points import points_and_bounds

    require(
        photos.is_dir(),
        f"{photos}: expected a folder of the model's photos, got no such folder; correct"
        " scene.images",
    )
    model = _model(folder, photos, options.model)
    where = f"scene={loader}: {folder}"
    files = find_photos(photos, model.names, where)
    warn_unplaced(photos, files.values())
    names, lenses = [model.names[i] for i in files], [model.lenses[i] for i in files]
    viewmats = [decoded_as(model.viewmats[i], Colmap.poses, options.poses) for i in files]
    masked = find_masks(masks or folder, photos.name, names)
    listed = [*map(Photo, files.values(), names, lenses, viewmats, masked)]
    split = protocol(options.split).split(names, options.n_views, where)
    train, test = read_shots(listed.__getitem__, split, options.downscale)
    tracks, near, far = points_and_bounds(
        model.tracks.of_images([*files]),
        viewmats,
        split.train,
        train,
        options.near,
        options.far,
        where,
    )
    name = name or folder.resolve().name
    return assemble(name, options.split, train, test, tracks, near, far)


def _model(folder: Path, photos: Path, option: str) -> Model:
    from framework.scenes.colmap_model import choose_model
    from framework.scenes.listed import match_photos

    chosen = choose_model(folder, option, lambda model: len(match_photos(photos, model.names)))
    if chosen is None:
        raise UserError(
            f"{folder}: expected a COLMAP model in sparse/0 or sparse (cameras, images, points3D as"
            " .bin or .txt), found none; is scene.path right? For photos without poses:"
            " scene=photos"
        )
    return chosen[1]
