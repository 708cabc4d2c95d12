"""`scene=colmap`: photos and a COLMAP sparse model (`sparse/0` or `sparse`, bin or txt).

Cameras: PINHOLE, SIMPLE_PINHOLE, and SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV (their photos are
undistorted to a pinhole of the same focal lengths; pixels that the lens did not see get mask 0).
Photos may have any size of the model's proportions, rounded (`images_4`); K is scaled by the exact
ratio of the sizes. Near and far are the 0.1 and 99.9 percentiles, as in LLFF, of the depths at
which the training views see points; they count every point with a training view in its track.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.formats import find_photo
from framework.scenes.options import check_folder_options, check_images
from framework.scenes.splits import protocol

if TYPE_CHECKING:
    from framework.scenes.colmap_model import Model
    from framework.types import Scene


@dataclass(frozen=True)
class Colmap:
    """Options of `scene=colmap`."""

    path: str  # folder of the scene
    n_views: int | str = 12  # training views; all = every one that is not for testing
    images: str = "images"  # folder of the photos inside path
    downscale: int = 1  # photos are reduced by it, averaging boxes of pixels
    split: str = "llff"  # which views train and which test: llff, mip360, dtu; none = no test

    def __post_init__(self) -> None:
        check_folder_options("colmap", self.path, self.n_views, self.split, self.downscale)
        check_images("colmap", self.images)

    def load(self) -> Scene:
        """The scene. Raises UserError where folder, model and photos do not fit together."""
        from framework.scenes.images import scene_folder

        folder = scene_folder("colmap", self.path)
        return load_colmap("colmap", folder, inside(folder, self.images), self)


def load_colmap(
    loader: str, folder: Path, photos: Path, options: Colmap, name: str | None = None
) -> Scene:
    """The scene of the model in `folder` and the images in `photos`, for `scene=<loader>`. It is
    called `name`, or as the folder."""
    from framework.scenes.assemble import assemble
    from framework.scenes.colmap_model import find_model, read_model
    from framework.scenes.photo import check_memory, photo_shot
    from framework.scenes.points import depth_bounds

    require(
        photos.is_dir(),
        f"{photos}: expected a folder of the model's photos, got no such folder; correct"
        " scene.images",
    )
    model = read_model(find_model(folder))
    where = f"scene={loader}: {folder}"
    split = protocol(options.split).split(model.names, options.n_views, where)
    files = _files(photos, model)
    check_memory([files[i] for i in (*split.train, *split.test)], options.downscale)
    train, test = (
        [
            photo_shot(
                files[i], model.names[i], model.lenses[i], model.viewmats[i], options.downscale
            )
            for i in part
        ]
        for part in (split.train, split.test)
    )
    near, far = depth_bounds(model.tracks, model.viewmats, split.train, where)
    tracks = model.tracks.for_training(split.train)
    called = folder.resolve().name if name is None else name
    return assemble(called, options.split, train, test, tracks, near, far)


def _files(folder: Path, model: Model) -> list[Path]:
    """The photo of each image of the model, by name."""
    files = [find_photo(folder, name) for name in model.names]
    missing = [f.name for f in files if not is_file(f)]
    require(
        not missing,
        f"{folder}: expected the {len(files)} images of the model, {len(missing)} missing (first:"
        f" {missing[0] if missing else ''}); restore them or choose another scene.images",
    )
    return files
