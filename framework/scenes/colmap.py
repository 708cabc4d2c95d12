"""`scene=colmap`: photos and a COLMAP sparse model (bin or txt).

Among several models (`sparse/0`, `sparse/1`, `sparse`, nerfstudio's `colmap/sparse/0`), the one
with poses for most of the photos is used. Photos without a pose and poses without a photo are left
out.

Cameras: PINHOLE, SIMPLE_PINHOLE, and SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, whose photos are
undistorted to a pinhole of the same focal lengths (pixels outside the photo get mask 0). Photos may
have any size of the model's proportions, rounded (`images_4`). Near and far are the 0.1 and 99.9
percentiles, as in LLFF, of the depths of points in the training views; `points` handles models
without points or tracks. Pixels that are black in `masks/`, or transparent, do not count.

`scene=mip360` is the Mip-NeRF 360 data set (Barron et al. 2022): `sparse/0` for the full-size
photos and these reduced, `images_2`, `images_4`, `images_8`. Sparse-view work (FSGS, CoR-GS,
DropGaussian) trains on 12 or 24 views at an eighth of the size and tests on every 8th photo, see
protocol `mip360`. Its photos are free of distortion.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.colmap_model import choose_model
from framework.scenes.conventions import decoded_as
from framework.scenes.images import EIGHTH_OR_FULL, photo_folder
from framework.scenes.layout import FolderScene, Listing
from framework.scenes.listed import find_photos, match_photos, warn_unplaced
from framework.scenes.masks import find_masks
from framework.scenes.photo import Photo
from framework.scenes.splits import protocol


@dataclass(frozen=True)
class Colmap(FolderScene):
    """Options of `scene=colmap`."""

    layout: ClassVar[str] = "colmap"

    images: str = "images"  # folder of the photos inside path
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    poses: str = "opencv_w2c"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def listing(self, folder: Path) -> Listing:
        return list_colmap(self, folder, inside(folder, self.images))


@dataclass(frozen=True)
class Mip360(Colmap):
    """The Mip-NeRF 360 data set, photos at an eighth of their size where they exist."""

    layout: ClassVar[str] = "mip360"

    images: str = "auto"  # folder of the photos; auto = images_8 where there is one, else images
    split: str = "mip360"  # which views train and which test: llff, mip360, dtu; none = no test

    def listing(self, folder: Path) -> Listing:
        photos = photo_folder(self.layout, folder, self.images, EIGHTH_OR_FULL, "sparse/0/")
        return list_colmap(self, folder, photos)


def list_colmap(
    options: Colmap,
    folder: Path,
    photos: Path,
    loader: str | None = None,
    masks: Path | None = None,
) -> Listing:
    """List the images of the model in `folder`, whose files are in `photos`.

    Args:
        loader: name for messages; by default that of the options.
        masks: the folder that has `masks/`; default `folder`.
    """
    require(
        photos.is_dir(),
        f"{photos}: expected a folder of the model's photos, got no such folder; correct"
        " scene.images",
    )
    where = f"scene={loader or options.layout}: {folder}"
    chosen = choose_model(folder, options.model, lambda m: len(match_photos(photos, m.names)))
    if chosen is None:
        raise UserError(
            f"{folder}: expected a COLMAP model in sparse/0 or sparse (cameras, images, points3D as"
            " .bin or .txt), found none; is scene.path right? For photos without poses:"
            " scene=photos"
        )
    _, model = chosen
    files = find_photos(photos, model.names, where)
    warn_unplaced(photos, files.values())
    names, lenses = [model.names[i] for i in files], [model.lenses[i] for i in files]
    viewmats = [decoded_as(model.viewmats[i], Colmap.poses, options.poses) for i in files]
    masked = find_masks(masks or folder, photos.name, names)
    return Listing(
        folder.resolve().name,
        where,
        viewmats,
        [*map(Photo, files.values(), names, lenses, viewmats, masked)].__getitem__,
        protocol(options.split).split(names, options.n_views, where),
        model.tracks.of_images([*files]),
        options.near,
        options.far,
    )
