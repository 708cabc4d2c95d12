"""`scene=transforms`: photos with a `transforms.json`, as instant-ngp, NeRF and nerfstudio use it.

Each of `frames` has a `file_path` (relative to the file, with or without the suffix) and a
`transform_matrix`, camera-to-world with OpenGL axes (x right, y up, z backward). Intrinsics are
`fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` or `camera_angle_x` (radians), once for all or per frame;
`k1`, `k2`, `k3`, `p1`, `p2` are OpenCV's, and the photos are undistorted. The world of the file is
kept: `applied_transform`, `scale` and `aabb_scale` say how others turned or framed it. Transparent
photos are laid on white or black, on which renders are then drawn too.

`split=llff` names no standard of these scenes; it is the usual every-8th rule on the sorted paths.
`split=file` takes the file's own `test_filenames` (or `val_filenames`) and `train_filenames`.
A frame's `mask_path` is a picture, black where the photo does not count.
Depth bounds are those of the training views' points, as in `scene=colmap`, unless given.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from os.path import splitext
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.options import check_choice, check_folder_options
from framework.scenes.splits import FILES, Split, protocol, told

if TYPE_CHECKING:
    from framework.scenes.assemble import Shot, Tracks
    from framework.scenes.transforms_file import Frame
    from framework.types import Scene

log = logging.getLogger(__name__)

PAPERS = {"white": 255, "black": 0}  # grey values


@dataclass(frozen=True)
class Transforms:
    """Options of `scene=transforms`.

    points: auto = the COLMAP model `sparse/0` where there is one; none; or a PLY file of points,
    relative to path. A PLY has no tracks: it must have been made from the training views alone.
    near, far: depth bounds in scene units; null = from the points.
    """

    path: str  # folder of the scene
    n_views: int | str = 12  # training views; all = every one that is not for testing
    file: str = "transforms.json"  # of cameras and photos, inside path
    downscale: int = 1  # photos are reduced by it, averaging boxes of pixels
    paper: str = "white"  # what transparent photos are laid on: white, black
    points: str = "auto"
    near: float | None = None
    far: float | None = None
    split: str = "llff"  # which views train and which test: llff, mip360, dtu, file; none = no test

    def __post_init__(self) -> None:
        split = "llff" if self.split in FILES else self.split
        check_folder_options("transforms", self.path, self.n_views, split, self.downscale)
        check_choice("transforms", "paper", self.paper, tuple(PAPERS))
        check_range("transforms", self.near, self.far)

    def load(self) -> Scene:
        """The scene. Raises UserError where file and photos do not hold what they must."""
        from framework.scenes.assemble import assemble
        from framework.scenes.images import scene_folder
        from framework.scenes.photo import check_memory
        from framework.scenes.transforms_file import read_frames

        folder = scene_folder("transforms", self.path)
        file = inside(folder, self.file)
        frames = read_frames(file)
        where = f"scene=transforms: {folder}"
        split = self._split(file, [f.name for f in frames], where)
        check_memory([frames[i].file for i in (*split.train, *split.test)], self.downscale)
        train, test = (
            [shot(frames[i], self.paper, self.downscale) for i in part]
            for part in (split.train, split.test)
        )
        tracks = self._tracks(folder, frames, split, train)
        near, far = self._bounds(tracks, frames, split, where)
        points = tracks.for_training(split.train)
        name, paper = folder.resolve().name, PAPERS[self.paper] / 255
        return assemble(name, self.split, train, test, points, near, far, paper)

    def _split(self, file: Path, names: list[str], where: str) -> Split:
        """By the rule, or by what the file says; warns where the rule trains on its test photos."""
        from framework.scenes.transforms_file import read_roles

        train, test = read_roles(file)
        own = told(names, train, test, self.split)
        if self.split in FILES:
            require(
                bool(test),
                f"{file}: expected test_filenames or val_filenames for scene.split={self.split},"
                " got none; name test photos there or take scene.split=llff",
            )
            known = {*names, *(splitext(name)[0] for name in names)}
            strange = sorted((train | test) - known)
            require(
                not strange,
                f"{file}: expected the photos of train_filenames and test_filenames among its"
                f" frames, {len(strange)} are not (first: {strange[0] if strange else ''}); correct"
                " their names or take scene.split=llff",
            )
            return own.split(names, self.n_views, where)
        split = protocol(self.split).split(names, self.n_views, where)
        both = sorted(set(own.divide(len(names))[1]) & set(split.train))
        if both:
            log.warning(
                f"{file} names test photos, and scene.split={self.split} trains on {len(both)} of"
                f" them (first: {names[both[0]]}); scene.split=file tests on them"
            )
        return split

    def _tracks(self, folder: Path, frames: list[Frame], split: Split, train: list[Shot]) -> Tracks:
        """Points with their tracks over all frames; those of a PLY only over the training ones."""
        import numpy as np

        from framework.scenes.assemble import Tracks
        from framework.scenes.points import colmap_tracks, ply_points

        if self.points == "none":
            return Tracks()
        if self.points == "auto":
            names, viewmats = [f.name for f in frames], [f.viewmat for f in frames]
            return colmap_tracks(folder, self.file, names, viewmats)
        found = ply_points(inside(folder, self.points), train)
        seen = np.zeros((len(found.xyz), len(frames)), dtype=bool)
        seen[:, list(split.train)] = found.seen
        return Tracks(found.xyz, found.rgb, seen)

    def _bounds(
        self, tracks: Tracks, frames: list[Frame], split: Split, where: str
    ) -> tuple[float, float]:
        """(near, far): given, or from the points; without points both must be given."""
        from framework.scenes.points import depth_bounds

        if self.near is not None and self.far is not None:
            return self.near, self.far
        if not len(tracks.xyz):
            raise UserError(
                f"{where}: expected sparse points to know the depth bounds from, found none; give"
                " scene.near and scene.far in the units of the poses"
            )
        near, far = depth_bounds(tracks, [f.viewmat for f in frames], split.train, where)
        near, far = self.near or near, self.far or far
        require(
            near < far,
            f"{where}: expected near < far, got near={near:.4g}, far={far:.4g} (one of them from"
            " the points); give both",
        )
        return near, far


def check_range(loader: str, near: float | None, far: float | None) -> None:
    """Bounds of depth, of which either may be None."""
    given = [bound for bound in (near, far) if bound is not None]
    require(
        all(0 < bound < math.inf for bound in given) and given == sorted(set(given)),
        f"scene={loader}: expected 0 < near < far, got near={near}, far={far}; correct scene.near"
        " and scene.far",
    )


def shot(frame: Frame, paper: str, downscale: int) -> Shot:
    """The photo of a frame with its camera and mask, reduced; transparent ones on that of
    `PAPERS`. Raises UserError for a bad file or one of other proportions."""
    from framework.files.limits import PHOTO_PIXELS
    from framework.scenes.decoding import image_size
    from framework.scenes.images import read_mask, read_on_paper
    from framework.scenes.photo import pinhole_shot, reading

    lens = frame.lens(*image_size(frame.file, PHOTO_PIXELS))
    how = reading(frame.file, lens, downscale, sized={"w", "h"} <= frame.values.keys())
    image, clear = read_on_paper(frame.file, PAPERS[paper], how.factor, how.turn)
    height, width = image.shape[:2]
    mask = None if frame.mask is None else read_mask(frame.mask, height, width, how.factor)
    require(
        mask is None or bool(mask.any()),
        f"{frame.mask}: expected a mask with some white pixels, got none; replace the mask",
    )
    rest = downscale // how.factor
    made = pinhole_shot(frame.name, frame.viewmat, how.K, image, lens.distortion, mask, rest)
    return replace(made, clear=clear, exif=how.exif)
