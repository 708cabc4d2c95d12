"""`scene=transforms`: photos and a `transforms.json` of instant-ngp, NeRF or nerfstudio.

Each of `frames` has a `file_path` (relative to the file, with or without suffix) and a
`transform_matrix`, camera-to-world with OpenGL axes (x right, y up, z backward). Intrinsics are
`fl_x`, `fl_y`, `cx`, `cy`, `w`, `h` or `camera_angle_x` (radians), once for all or per frame. `k1`,
`k2`, `k3`, `p1`, `p2` are OpenCV's, and the photos are undistorted. The world of the file is kept:
`applied_transform`, `scale` and `aabb_scale` are ignored. Transparent photos are composited over
white or black, which is then also the background of renders.

`split=llff` is the usual every-8th rule on the sorted paths; these scenes have no standard split.
`split=file` uses the file's `test_filenames` (or `val_filenames`) and `train_filenames`.
A frame's `mask_path` is a picture, black where the photo does not count. Frames without one use
`masks/` (see `masks`). Frames without a photo are left out.

Points come from the COLMAP model with the poses of the file, also after nerfstudio's
`applied_transform`, else from the PLY file of its `ply_file_path`. Depth bounds are those of the
training views' points, as in `scene=colmap`, unless given.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from os.path import splitext
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.options import check_choice, check_folder_options
from framework.scenes.splits import FILES, Split, file_protocol, protocol

if TYPE_CHECKING:
    from framework.scenes.assemble import Tracks
    from framework.scenes.transforms_file import Frame
    from framework.types import Scene

log = logging.getLogger(__name__)

PAPERS = {"white": 255, "black": 0}  # grey values


@dataclass(frozen=True)
class Transforms:
    """Options of `scene=transforms`.

    Attributes:
        points: auto = the COLMAP model or the file's `ply_file_path`; none; or a PLY file of
            points, relative to path. A PLY has no tracks: it should be made from the training views
            alone.
        near, far: depth bounds in scene units; null = from the points.
    """

    path: str  # folder of the scene
    n_views: int | str = 12  # training views; all = every one that is not for testing
    file: str = "transforms.json"  # of cameras and photos, inside path
    downscale: int = 1  # photos are reduced by it, averaging boxes of pixels
    paper: str = "white"  # background of transparent photos: white, black
    points: str = "auto"
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    near: float | None = None
    far: float | None = None
    split: str = "llff"  # which views train and which test: llff, mip360, dtu, file; none = no test
    poses: str = "opengl_c2w"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def __post_init__(self) -> None:
        check_folder_options("transforms", self, files=True)
        check_choice("transforms", "paper", self.paper, tuple(PAPERS))

    def load(self) -> Scene:
        """Load the scene.

        Raises:
            UserError: if file and photos do not fit together.
        """
        from framework.scenes.assemble import Tracks, assemble
        from framework.scenes.images import scene_folder
        from framework.scenes.photo import read_shots
        from framework.scenes.points import points_and_bounds
        from framework.scenes.transforms_file import read_frames, with_photos

        folder = scene_folder("transforms", self.path)
        file = inside(folder, self.file)
        listed = read_frames(file, self.poses)
        where = f"scene=transforms: {folder}"
        frames = [*with_photos(file, listed).values()]
        split = self._split(file, [f.name for f in frames], {f.name for f in listed}, where)
        paper = PAPERS[self.paper]
        train, test = read_shots(lambda i: frames[i].photo(), split, self.downscale, paper)
        tracks, near, far = points_and_bounds(
            self._tracks(folder, file, frames),
            [f.viewmat for f in frames],
            split.train,
            train,
            self.near,
            self.far,
            where,
        )
        if self.points == "none":  # they only gave the bounds
            tracks = Tracks()
        name = folder.resolve().name
        return assemble(name, self.split, train, test, tracks, near, far, paper / 255)

    def _split(self, file: Path, names: list[str], listed: set[str], where: str) -> Split:
        """Split by a rule or by the file; warns if the rule trains on the file's test photos."""
        from framework.scenes.transforms_file import read_roles

        train, test = read_roles(file)
        by_file = file_protocol(names, train, test, self.split)
        if self.split in FILES:
            strange = sorted((train | test) - {*listed, *(splitext(name)[0] for name in listed)})
            require(
                not strange,
                f"{file}: expected the photos of train_filenames and test_filenames among its"
                f" frames, {len(strange)} are not (first: {strange[0] if strange else ''}); correct"
                " their names or use scene.split=llff",
            )
            require(
                bool(test) and bool(by_file.divide(len(names))[1]),
                f"{file}: expected photos of its test_filenames or val_filenames for"
                f" scene.split={self.split}, got none; name or restore them, or use"
                " scene.split=llff",
            )
            return by_file.split(names, self.n_views, where)
        split = protocol(self.split).split(names, self.n_views, where)
        both = sorted(set(by_file.divide(len(names))[1]) & set(split.train))
        if both:
            log.warning(
                f"{file} names test photos, and scene.split={self.split} trains on {len(both)} of"
                f" them (first: {names[both[0]]}); scene.split=file tests on them"
            )
        return split

    def _tracks(self, folder: Path, file: Path, frames: list[Frame]) -> Tracks:
        """Read the points, with their tracks over all frames."""
        from framework.scenes.assemble import Tracks, untracked
        from framework.scenes.coloured import read_coloured
        from framework.scenes.model_points import colmap_tracks
        from framework.scenes.transforms_file import read_extras

        if self.points == "none":
            return Tracks()
        if self.points != "auto":
            return untracked(*read_coloured(inside(folder, self.points)), len(frames))
        extras = read_extras(file)
        names, viewmats = [f.name for f in frames], [f.viewmat for f in frames]
        tracks = colmap_tracks(folder, self.file, names, viewmats, self.model, extras.worlds)
        if len(tracks.xyz) or extras.ply is None:
            return tracks
        try:
            return untracked(*read_coloured(extras.ply), len(frames))
        except UserError as error:
            log.warning(f"{error}; the points of ply_file_path are not used")
            return tracks
