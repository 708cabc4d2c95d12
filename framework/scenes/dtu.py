"""`scene=dtu`: a scan of the DTU data set in the layout of IDR and NeuS.

The layout is `cameras_sphere.npz` (or `cameras.npz`), `mask/000.png` ..., and the 49 photos of the
rig in `images/` or `image/`. Photos may also have MVSNet's names in `Rectified/`, of light 3 as
RegNeRF uses them: `rect_001_3_r5000.png` is position 0. MVSNet's `Cameras/` are not read.

`world_mat_i` is the 3 x 4 projection K [R | t] of position i in millimetres, for photos of
1600 x 1200. By default photos are reduced to the usual 400 x 300. Near and far are the depths of
425 to 935 mm that stereo on this rig searches (Yao et al. 2018, MVSNet, with CasMVSNet's end).
Sparse points come from the COLMAP model with these poses, if there is one. Missing photos are left
out; the positions keep their numbers. Transparent pixels do not count.

Protocol (see `splits`): tests measure the object only. PSNR covers the mask; the other metrics see
white elsewhere in render and truth (RegNeRF; CoR-GS's `metrics_dtu.py`). Training (`train_mask`):
- background: all but the black surroundings of the table, as in DNGaussian and CoR-GS. These are
  pixels with every channel below 30 / 255 (scan 110: 15) under 49 pixels that are as dark. The
  papers also push the opacity there to 0; here these pixels have no loss.
- full: the whole photo, as in pixelNeRF and RegNeRF.
- object: the object alone, which needs masks of the training photos.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.formats import listed
from framework.scenes.options import check_choice, check_folder_options
from framework.scenes.splits import protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.scenes.assemble import Shot
    from framework.scenes.splits import Split
    from framework.types import Scene

log = logging.getLogger(__name__)

POSITION = re.compile(r"(\d{1,9})|rect_(\d{3})_3_r5000", re.ASCII)
TRAIN_MASKS = ("background", "full", "object")
NEAR_MM, FAR_MM = 425.0, 935.0
USUAL_WIDTH = 400
DARK, DARK_SCAN_110 = 30, 15  # grey values below which a pixel may be background
MOST = 1000  # positions
DARK_RUN = 50  # pixels: a background pixel and those above it


@dataclass(frozen=True)
class Dtu:
    """Options of `scene=dtu`.

    Attributes:
        near, far: depth bounds in millimetres.
    """

    path: str  # folder of the scene
    n_views: int | str = 3  # training views; all = every one that is not for testing
    scan: int | None = None  # which scan, where path is a folder of scans
    images: str = "auto"  # folder of the photos; auto = images where there is one, else image
    downscale: int | None = None  # photos are reduced by it; null = to 400 x 300
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    near: float = NEAR_MM
    far: float = FAR_MM
    train_mask: str = "background"  # what of the training photos counts: background, full, object
    split: str = "dtu"  # which views train and which test: llff, mip360, dtu; none = no test

    def __post_init__(self) -> None:
        check_folder_options("dtu", self)
        check_choice("dtu", "train_mask", self.train_mask, TRAIN_MASKS)

    def load(self) -> Scene:
        """Load the scene.

        Raises:
            UserError: if the folder lacks a part of the layout.
        """
        from framework.scenes.assemble import assemble
        from framework.scenes.dtu_cameras import read_cameras
        from framework.scenes.images import photo_folder
        from framework.scenes.model_points import colmap_tracks
        from framework.scenes.photo import Photo, read_shots
        from framework.scenes.points import points_and_bounds

        folder = scan_folder(self.path, self.scan)
        where = f"scene=dtu: {folder}"
        layout = "mask/ and cameras_sphere.npz"
        require(
            self.images != "auto" or not (folder / "Rectified").is_dir(),
            f"scene=dtu: expected images/, mask/ and cameras_sphere.npz of one scan, as IDR and"
            f" NeuS share DTU, in '{folder}', got MVSNet's layout (Rectified/, Cameras/), which is"
            " not read; download the scans in IDR's layout",
        )
        files = _numbered(photo_folder("dtu", folder, self.images, ("images", "image"), layout))
        masks = _masks(folder, files)
        split = self._split([*files], where)
        cameras = read_cameras(folder, [*files])

        def photo_at(i: int) -> Photo:
            mask = masks[i] if i in split.test or self.train_mask == "object" else None
            return Photo(files[i], files[i].name, cameras[i].lens, cameras[i].viewmat, mask)

        train, test = read_shots(photo_at, split, self._downscale(next(iter(files.values()))))
        if self.train_mask == "background":
            level = DARK_SCAN_110 if folder.name.endswith("scan110") else DARK
            train = [_without_background(shot, level) for shot in train]
        names, viewmats = [f.name for f in files.values()], [cameras[i].viewmat for i in files]
        points, near, far = points_and_bounds(
            colmap_tracks(folder, "the cameras' file", names, viewmats, self.model),
            viewmats,
            [[*files].index(i) for i in split.train],
            train,
            self.near,
            self.far,
            where,
        )
        return assemble(folder.name, self.split, train, test, points, near, far)

    def _split(self, positions: Sequence[int], where: str) -> Split:
        """Split the rig's positions; logs a warning about those without a photo."""
        rule = protocol(self.split)
        count = max(rule.images or 0, positions[-1] + 1)
        missing = sorted({*range(count)} - {*positions})
        if missing:
            log.warning(
                f"{where}: {len(missing)} of {count} photos are missing and left out"
                f" ({listed([f'{i:06d}' for i in missing])}); restore them"
            )
        names = [f"{i:06d}" for i in range(count)]
        return rule.split(names, self.n_views, where, missing)

    def _downscale(self, file: Path) -> int:
        """The option, or the factor that makes photos 400 pixels wide."""
        from framework.files.limits import PHOTO_PIXELS
        from framework.scenes.decoding import image_size

        if self.downscale is not None:
            return self.downscale
        width, height = image_size(file, PHOTO_PIXELS)
        factor = max(1, round(width / USUAL_WIDTH))
        if width != factor * USUAL_WIDTH:
            log.warning(
                f"{file}: photos of {width}x{height} are reduced to {width // factor}x"
                f"{height // factor}, not the 400x300 of the usual protocol; for that use photos"
                " of 1600x1200 or 800x600"
            )
        return factor


def _without_background(shot: Shot, level: int) -> Shot:
    kept = 1 - background(shot.image, level)
    return replace(shot, mask=kept if shot.mask is None else kept * shot.mask)


def scan_folder(path: str, scan: int | None) -> Path:
    """The folder of the scan.

    Raises:
        UserError: for an unknown one, with a list of all.
    """
    from framework.scenes.images import scene_folder

    folder = scene_folder("dtu", path).resolve()
    if scan is None:
        return folder
    for name in (f"dtu_scan{scan}", f"scan{scan}"):
        if (folder / name).is_dir():
            return folder / name
    scans = sorted(
        int(match.group(1))
        for entry in folder.iterdir()
        if (match := re.fullmatch(r"(?:dtu_)?scan(\d+)", entry.name))
    )
    raise UserError(
        f"scene=dtu: expected scan {scan} in {folder} as dtu_scan{scan} or scan{scan}, found scans:"
        f" {', '.join(map(str, scans)) or 'none'}; correct scene.scan or scene.path"
    )


def background(image: NDArray[np.uint8], level: int) -> NDArray[np.float32]:
    """Find the dark surroundings of the table.

    Returns:
        [H, W] float32, 1 for pixels of `image` [H, W, 3] that are darker than `level` in every
        channel, if the DARK_RUN - 1 pixels above (as far as the image reaches) are too.
    """
    import numpy as np

    dark = image.max(axis=2) < level
    rows = np.arange(len(dark))[:, None]
    last_bright = np.maximum.accumulate(np.where(dark, -DARK_RUN, rows), axis=0)
    return (rows - last_bright >= DARK_RUN).astype(np.float32)


def _numbered(folder: Path) -> dict[int, Path]:
    """The images of `folder` by the rig position in their names, from 0."""
    from framework.scenes.images import list_images

    images = list_images(folder)
    files = {_position(file): file for file in images}
    wrong = [f.name for f in images if files[_position(f)] != f or not 0 <= _position(f) < MOST]
    require(
        not wrong,
        f"{folder}: expected files named after the rig's positions from 0 (000000.png, 000001.png"
        f" ...), each once, got {wrong[0] if wrong else ''}; rename them",
    )
    return dict(sorted(files.items()))


def _position(file: Path) -> int:
    """The number in the name of a photo; -1 for another name."""
    match = POSITION.fullmatch(file.stem)
    if match is None:
        return -1
    return int(match[1]) if match[1] else int(match[2]) - 1


def _masks(folder: Path, files: dict[int, Path]) -> dict[int, Path]:
    masks = _numbered(inside(folder, "mask"))
    bare = [file.name for i, file in files.items() if i not in masks]
    require(
        not bare,
        f"{folder}: expected a mask for each of {len(files)} photos, got {len(files) - len(bare)};"
        f" restore those of {listed(bare)}",
    )
    if (folder / "masks").is_dir():
        log.warning(
            f"{folder / 'masks'}: not used, as scene=dtu takes the object's mask from mask/"
        )
    return masks
