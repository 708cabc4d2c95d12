"""`scene=photos`: a folder of photos, or a video, without camera poses.

pycolmap finds the poses in a child process, with settings for few photos and several attempts (see
`options`). The result is kept in the user's cache, in `poses/fishersplat-poses-<hash of the photos'
content>`; nothing is written next to the photos. That folder is loaded as a scene of
`scene=colmap`, so the same photos always give the same scene. On one machine pycolmap repeats bit
for bit, for any number of threads; another machine may round differently.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from framework.errors import check_option
from framework.files.limits import PHOTO_PIXELS
from framework.scenes.colmap import Colmap, list_colmap
from framework.scenes.decoding import image_size
from framework.scenes.layout import FolderScene, load_listed
from framework.scenes.photos.networks import NAME as NETWORKS
from framework.scenes.photos.options import LEARNED, SIFT
from framework.scenes.splits import ALL

if TYPE_CHECKING:
    from framework.types import Scene

TRAINED_SIDE = 800  # pixels; what a CPU trains in minutes

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Photos(FolderScene):
    """Photos without poses: pycolmap finds them, once.

    Attributes:
        near, far: depth bounds in units of the poses; null = from the points.
    """

    layout: ClassVar[str] = "photos"
    least_downscale: ClassVar[int] = 0

    path: str  # folder of the photos, or a video
    n_views: int | str = ALL  # training views; all = every one that is not for testing
    downscale: int = 0  # by which they are then reduced; 0 = until the longer side is at most 800
    side: int = 1200  # pixels; larger photos are first reduced to this longer side
    frames: int = 40  # of a video: so many of its frames are taken, the sharpest ones
    matching: str = SIFT  # sift; learned = by networks first, see `fishersplat fetch matching`

    def __post_init__(self) -> None:
        super().__post_init__()
        check_option(self, "scene", "side", 64 <= self.side <= 8192, "64 to 8192 pixels")
        check_option(self, "scene", "frames", 3 <= self.frames <= 1000, "3 to 1000")
        self.expect_choice("matching", (SIFT, LEARNED))

    @property
    def learned_weights(self) -> str:
        """The networks that match the photos; "" if none does."""
        return NETWORKS if self.matching == LEARNED else ""

    def load(self) -> Scene:
        """Load the scene; the first time this takes from seconds to many minutes.

        Raises:
            UserError: too few photos can be placed.
        """
        from framework.scenes.photos.advice import advice
        from framework.scenes.photos.process import poses_folder
        from framework.scenes.photos.result import read_result
        from framework.scenes.photos.source import find_source

        source = find_source(self.path, self.side, self.frames, self.matching)
        folder = poses_folder(source)
        result = read_result(folder)
        counts = (len(result.placed), len(result.photos))
        log.info("scene=photos: %d of %d photos have poses, kept in %s", *counts, folder)
        for line in advice(result):
            log.warning("scene=photos: %s", line)
        images = folder / "images"
        sizes = [image_size(images / name, PHOTO_PIXELS) for name in result.placed]
        downscale = self.downscale or -(-max(max(size) for size in sizes) // TRAINED_SIDE)
        if downscale > 1 or result.reduced:
            width, height = sizes[0]
            log.info(
                "scene=photos: trained at %dx%d pixels (scene.downscale=%d of %dx%d)",
                *(width // downscale, height // downscale, downscale, width, height),
            )
        shared = {name: getattr(self, name) for name in ("n_views", "near", "far", "split")}
        options = Colmap(str(folder), downscale=downscale, **shared)
        masks = source.folder.parent if source.folder.name == "images" else source.folder
        listed = list_colmap(options, folder, images, self.layout, masks)
        return load_listed(options, replace(listed, name=source.title))
