"""`scene=mip360`: a scene of the Mip-NeRF 360 data set (Barron et al. 2022): `sparse/0` for the
full-size photos and these reduced, `images_2`, `images_4`, `images_8`.

Sparse-view work (FSGS, CoR-GS, DropGaussian) trains on 12 or 24 views at an eighth of the size and
tests on every 8th photo, see protocol `mip360`. The data set's photos are free of distortion. All
else, as the choice among several models, is as in `scene=colmap`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.scenes.colmap import Colmap, load_colmap
from framework.scenes.options import check_folder_options

if TYPE_CHECKING:
    from framework.types import Scene


@dataclass(frozen=True)
class Mip360(Colmap):
    """Options of `scene=mip360`."""

    images: str = "auto"  # folder of the photos; auto = images_8 where there is one, else images
    split: str = "mip360"  # which views train and which test: llff, mip360, dtu; none = no test

    def __post_init__(self) -> None:
        check_folder_options("mip360", self)

    def load(self) -> Scene:
        """The scene.

        Raises:
            UserError: where folder, model and photos do not fit together.
        """
        from framework.scenes.images import EIGHTH_OR_FULL, photo_folder, scene_folder

        folder = scene_folder("mip360", self.path)
        photos = photo_folder("mip360", folder, self.images, EIGHTH_OR_FULL, "sparse/0/")
        return load_colmap("mip360", folder, photos, self)
