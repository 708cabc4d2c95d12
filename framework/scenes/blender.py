"""`scene=blender`: a rendered object in the layout of NeRF's synthetic data set (Mildenhall et al.
2020): `transforms_train.json` and `transforms_test.json` with PNG files, see `scene=transforms`.

Transparent photos are composited over white, as in papers; near and far are NeRF's. Without test
views (`split=none`) `transforms_test.json` may be missing.

`split=blender` is the literature's choice of few views (see `splits`), counted in the order of the
files. `split=file` is for your own objects: training views are evenly spaced in the one file, and
all photos of the other are test views.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import inverse, product
from framework.errors import require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.assemble import Tracks
from framework.scenes.layout import FolderScene, Listing
from framework.scenes.splits import (
    BLENDER_FILES,
    FILES,
    Split,
    file_protocol,
    protocol,
    untested,
)
from framework.scenes.transforms import PAPERS
from framework.scenes.transforms_file import read_frames, with_photos

log = logging.getLogger(__name__)

PARALLEL = 1e-3  # mean squared sine of the angle between optical axes and their main direction
TRAINING, TESTING = "transforms_train.json", "transforms_test.json"


@dataclass(frozen=True)
class Blender(FolderScene):
    """Options of `scene=blender`.

    Attributes:
        near, far: depth bounds in scene units, between which the object lies.
    """

    layout: ClassVar[str] = "blender"
    splits_by_file: ClassVar[bool] = True

    n_views: int | str = 8  # training views; all = every one that is not for testing
    downscale: int = 2  # photos are reduced by it, averaging boxes of pixels; 2 = papers' 400x400
    near: float = 2.0
    far: float = 6.0
    split: str = "blender"  # which views train and which test: blender, file; none = no test
    paper: str = "white"  # background of transparent photos: white, black
    poses: str = "opengl_c2w"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def __post_init__(self) -> None:
        super().__post_init__()
        self.expect_choice("paper", tuple(PAPERS))

    def listing(self, folder: Path) -> Listing:
        first = read_frames(inside(folder, TRAINING), self.poses)
        without_tests = untested(self.split) and not is_file(folder / TESTING)
        second = [] if without_tests else read_frames(inside(folder, TESTING), self.poses)
        both = sorted({f.file.resolve() for f in first} & {f.file.resolve() for f in second})
        require(
            not both,
            f"{folder / TESTING}: expected photos that {TRAINING} does not list, {len(both)} are in"
            f" both (first: {both[0].name if both else ''}); remove them from one of the files",
        )
        where = f"scene=blender: {folder}"
        frames = with_photos(folder / TRAINING, [*first, *second])
        missing = {*range(len(first) + len(second))} - {*frames}
        split = self._split(len(first), len(first) + len(second), missing, where)
        used = [frames[i].viewmat for i in (*split.train, *split.test)]
        _warn_of_depths(used, self.near, self.far, str(folder))
        existing = [*frames.values()]
        return Listing(
            folder.resolve().name,
            where,
            [frame.viewmat for frame in existing],
            lambda i: existing[i].photo(),
            split.among([*frames]),
            Tracks(),
            self.near,
            self.far,
            PAPERS[self.paper],
        )

    def _split(self, training: int, images: int, missing: set[int], where: str) -> Split:
        """Split `images` frames, the first `training` of which are of the training file."""
        counts = (training, images - training)
        require(
            not self.split.startswith("blender") or counts == BLENDER_FILES,
            f"{where}: expected 100 frames in {TRAINING} and 200 in {TESTING} for scene.split="
            f"{self.split}, got {counts[0]} and {counts[1]}; scene.split=file takes any numbers",
        )
        names = [f"{i:06d}" for i in range(images)]
        rule = protocol(self.split) if self.split not in FILES else None
        rule = rule or file_protocol(names, names[:training], names[training:], self.split)
        return rule.split(names, self.n_views, where, missing)


def _warn_of_depths(
    viewmats: Sequence[NDArray[np.float64]], near: float, far: float, where: str
) -> None:
    """Log a warning if the point that the cameras look at lies outside the depth bounds.

    It has the least squared distance to all optical axes, and exists unless these are almost
    parallel. Cameras that look away from it do not surround an object.
    """
    poses = np.array(viewmats)
    axes = poses[:, 2, :3]
    centers = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    if np.linalg.eigvalsh(across.mean(axis=0))[0] < PARALLEL:
        return
    point = product(inverse(across.sum(axis=0)), np.einsum("nij,nj->i", across, centers))
    depths = (axes * (point - centers)).sum(axis=1)
    depth = float(np.median(depths))
    if depths.min() > 0 and not near <= depth <= far:
        log.warning(
            f"{where}: the cameras look at a point at depth {depth:.3g}, outside"
            f" scene.near={near:g} and scene.far={far:g}; set these to the depths between which the"
            " object lies"
        )
