"""`scene=dtu`: a scan of the DTU data set in the layout of IDR and NeuS: `cameras_sphere.npz` (or
`cameras.npz`), `mask/000.png` ..., and the 49 photos of the rig in `images/` or `image/`.

`world_mat_i` is the 3 x 4 projection K [R | t] of position i for the rig's 1600 x 1200 photos, in
millimetres; photos may be smaller, by default they are reduced to the usual 400 x 300 pixels.
Near and far are the depths of 425 to 935 mm that stereo on this rig searches (Yao et al. 2018,
MVSNet, with CasMVSNet's end). Sparse points come from `sparse/0` where there is such a model.
Photos may also have the names of MVSNet's `Rectified/`, of light 3 as RegNeRF takes them:
`rect_001_3_r5000.png` is position 0. Its `Cameras/` are not read.

Protocol (see `splits`): tests measure the object only: PSNR over the mask, the other metrics with
all else white in render and truth (RegNeRF; CoR-GS's `metrics_dtu.py`). Training (`train_mask`):
- background: all but the black surroundings of the table, as DNGaussian and CoR-GS: pixels with
  every channel below 30 / 255 (scan 110: 15) whose 49 pixels above, as far as the photo reaches,
  are so dark too. These also push the opacity of the surroundings to 0; here they only have no say.
- full: the whole photo, as pixelNeRF and RegNeRF.
- object: the object alone, which needs masks of the training photos.
"""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.paths import inside
from framework.scenes.options import check_choice, check_folder_options, check_images
from framework.scenes.splits import protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.scenes.assemble import Shot
    from framework.scenes.dtu_cameras import Calibration
    from framework.types import Scene

log = logging.getLogger(__name__)

RECTIFIED = re.compile(r"rect_(\d{3})_3_r5000")
TRAIN_MASKS = ("background", "full", "object")
NEAR_MM, FAR_MM = 425.0, 935.0
USUAL_WIDTH = 400
DARK, DARK_SCAN_110 = 30, 15  # grey values below which a pixel may be background
DARK_RUN = 50  # pixels: a background pixel and those above it


@dataclass(frozen=True)
class Dtu:
    """Options of `scene=dtu`."""

    path: str  # folder of the scene
    n_views: int | str = 3  # training views; all = every one that is not for testing
    scan: int | None = None  # which scan, where path is a folder of scans
    images: str = "auto"  # folder of the photos; auto = images where there is one, else image
    downscale: int | None = None  # photos are reduced by it; null = to 400 x 300
    train_mask: str = "background"  # what of the training photos counts: background, full, object
    split: str = "dtu"  # which views train and which test: llff, mip360, dtu; none = no test

    def __post_init__(self) -> None:
        downscale = 1 if self.downscale is None else self.downscale
        check_folder_options("dtu", self.path, self.n_views, self.split, downscale)
        check_images("dtu", self.images)
        check_choice("dtu", "train_mask", self.train_mask, TRAIN_MASKS)

    def load(self) -> Scene:
        """The scene. Raises UserError where the folder does not hold what the layout asks for."""
        from framework.scenes.assemble import assemble
        from framework.scenes.dtu_cameras import read_cameras
        from framework.scenes.images import photo_folder
        from framework.scenes.photo import check_memory
        from framework.scenes.points import colmap_tracks

        folder = scan_folder(self.path, self.scan)
        beside = "mask/ and cameras_sphere.npz"
        require(
            self.images != "auto" or not (folder / "Rectified").is_dir(),
            f"scene=dtu: expected images/, mask/ and cameras_sphere.npz of one scan, as IDR and"
            f" NeuS share DTU, in '{folder}', got MVSNet's layout (Rectified/, Cameras/), which is"
            " not read; download the scans in IDR's layout",
        )
        files = _numbered(photo_folder("dtu", folder, self.images, ("images", "image"), beside))
        masks = _numbered(inside(folder, "mask"))
        require(
            len(masks) == len(files),
            f"{folder}: expected a mask for each of {len(files)} photos, got {len(masks)}; restore"
            " the missing ones",
        )
        cameras = read_cameras(folder, len(files))
        names = [f.name for f in files]
        positions = [f"{i:06d}" for i in range(len(files))]
        split = protocol(self.split).split(positions, self.n_views, f"scene=dtu: {folder}")
        factor = self._downscale(files[0])
        check_memory([files[i] for i in (*split.train, *split.test)], factor)
        train = [
            self._for_training(_shot(files[i], masks[i], cameras[i], factor), folder.name)
            for i in split.train
        ]
        test = [_shot(files[i], masks[i], cameras[i], factor) for i in split.test]
        viewmats = [camera.viewmat for camera in cameras]
        tracks = colmap_tracks(folder, "the cameras' file", names, viewmats)
        points = tracks.for_training(split.train)
        return assemble(folder.name, self.split, train, test, points, NEAR_MM, FAR_MM)

    def _downscale(self, file: Path) -> int:
        """The factor that was asked for, or that which makes photos 400 pixels wide."""
        from framework.files.limits import PHOTO_PIXELS
        from framework.scenes.decoding import image_size

        if self.downscale is not None:
            return self.downscale
        width, height = image_size(file, PHOTO_PIXELS)
        factor = max(1, round(width / USUAL_WIDTH))
        if width != factor * USUAL_WIDTH:
            log.warning(
                f"{file}: photos of {width}x{height} are reduced to {width // factor}x"
                f"{height // factor}, not the 400x300 of the usual protocol; for that take photos"
                " of 1600x1200 or 800x600"
            )
        return factor

    def _for_training(self, shot: Shot, scan: str) -> Shot:
        """The shot with the mask that training uses in place of the object's."""
        from dataclasses import replace

        if self.train_mask == "object":
            return shot
        if self.train_mask == "full":
            return replace(shot, mask=None)
        level = DARK_SCAN_110 if scan.endswith("scan110") else DARK
        return replace(shot, mask=1 - background(shot.image, level))


def scan_folder(path: str, scan: int | None) -> Path:
    """The folder of the scan. Raises UserError for an unknown one, listing those that are there."""
    from framework.scenes.images import scene_folder

    folder = scene_folder("dtu", path).resolve()
    if scan is None:
        return folder
    for name in (f"dtu_scan{scan}", f"scan{scan}"):
        if (folder / name).is_dir():
            return folder / name
    found = sorted(
        int(match.group(1))
        for entry in folder.iterdir()
        if (match := re.fullmatch(r"(?:dtu_)?scan(\d+)", entry.name))
    )
    raise UserError(
        f"scene=dtu: expected scan {scan} in {folder} as dtu_scan{scan} or scan{scan}, found scans:"
        f" {', '.join(map(str, found)) or 'none'}; correct scene.scan or scene.path"
    )


def background(image: NDArray[np.uint8], level: int) -> NDArray[np.float32]:
    """[H, W] float32, 1 for the pixels of `image` [H, W, 3] that are darker than `level` in every
    channel and so are the DARK_RUN - 1 above each, as far as the image reaches."""
    import numpy as np

    dark = image.max(axis=2) < level
    rows = np.arange(len(dark))[:, None]
    last_bright = np.maximum.accumulate(np.where(dark, -DARK_RUN, rows), axis=0)
    return (rows - last_bright >= DARK_RUN).astype(np.float32)


def _numbered(folder: Path) -> list[Path]:
    """The images of `folder` in the order of their positions 0, 1, ... on the rig, after which they
    are named."""
    from framework.scenes.images import list_images

    files = sorted(list_images(folder), key=lambda file: (_position(file), file.name))
    wrong = [f.name for i, f in enumerate(files) if _position(f) != i]
    require(
        not wrong,
        f"{folder}: expected files named after the rig's positions from 0 without a gap"
        f" (000000.png, 000001.png ...), got {wrong[0] if wrong else ''}; rename or restore them",
    )
    return files


def _position(file: Path) -> int:
    """The number in the name of a photo; -1 for another name."""
    if file.stem.isdecimal():
        return int(file.stem)
    rectified = RECTIFIED.fullmatch(file.stem)
    return int(rectified[1]) - 1 if rectified else -1


def _shot(file: Path, mask: Path, camera: Calibration, factor: int) -> Shot:
    """The photo with the object's mask."""
    from dataclasses import replace

    from framework.scenes.images import read_image, read_mask
    from framework.scenes.photo import pinhole_shot, reading

    how = reading(file, camera.lens, factor)
    image = read_image(file, how.factor, how.turn)
    height, width = image.shape[:2]
    valid = read_mask(mask, height, width, how.factor)
    require(bool(valid.any()), f"{mask}: expected some white pixels, got none; replace the mask")
    rest = factor // how.factor
    shot = pinhole_shot(file.name, camera.viewmat, how.K, image, mask=valid, downscale=rest)
    return replace(shot, exif=how.exif)
