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

import logging
from dataclasses import dataclass
from os.path import splitext
from pathlib import Path
from typing import ClassVar

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.assemble import Tracks
from framework.scenes.coloured import read_coloured
from framework.scenes.layout import FolderScene, Listing
from framework.scenes.model_points import colmap_tracks
from framework.scenes.splits import FILES, Split, file_protocol, protocol
from framework.scenes.transforms_file import (
    Frame,
    read_extras,
    read_frames,
    read_roles,
    with_photos,
)

log = logging.getLogger(__name__)

PAPERS = {"white": 255, "black": 0}  # grey values


@dataclass(frozen=True)
class Transforms(FolderScene):
    """Options of `scene=transforms`.

    Attributes:
        points: auto = the COLMAP model or the file's `ply_file_path`; none; or a PLY file of
            points, relative to path. A PLY has no tracks: it should be made from the training views
            alone.
    """

    layout: ClassVar[str] = "transforms"
    splits_by_file: ClassVar[bool] = True

    file: str = "transforms.json"  # of cameras and photos, inside path
    paper: str = "white"  # background of transparent photos: white, black
    points: str = "auto"
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    split: str = "llff"  # which views train and which test: llff, mip360, dtu, file; none = no test
    poses: str = "opengl_c2w"  # how the file writes poses: opencv, opengl or llff axes, c2w or w2c

    def __post_init__(self) -> None:
        super().__post_init__()
        self.expect_choice("paper", tuple(PAPERS))

    def listing(self, folder: Path) -> Listing:
        file, where = inside(folder, self.file), f"scene=transforms: {folder}"
        listed = sorted(read_frames(file, self.poses), key=lambda frame: frame.name)
        frames = [*with_photos(file, listed).values()]
        return Listing(
            folder.resolve().name,
            where,
            [frame.viewmat for frame in frames],
            lambda i: frames[i].photo(),
            self._split(file, [f.name for f in frames], {f.name for f in listed}, where),
            self._tracks(folder, file, frames),
            self.near,
            self.far,
            PAPERS[self.paper],
            points_train=self.points != "none",
        )

    def _split(self, file: Path, names: list[str], listed: set[str], where: str) -> Split:
        """Split by a rule or by the file; warns if the rule trains on the file's test photos."""
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
        if self.points == "none":
            return Tracks()
        if self.points != "auto":
            return read_coloured(inside(folder, self.points), len(frames))
        ply, worlds = read_extras(file)
        names, viewmats = [f.name for f in frames], [f.viewmat for f in frames]
        tracks = colmap_tracks(folder, self.file, names, viewmats, self.model, worlds)
        if len(tracks.xyz) or ply is None:
            return tracks
        try:
            return read_coloured(ply, len(frames))
        except UserError as error:
            log.warning(f"{error}; the points of ply_file_path are not used")
            return tracks
