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

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from framework.errors import UserError, require
from framework.files.limits import PHOTO_PIXELS
from framework.files.paths import inside
from framework.scenes.decoding import image_size
from framework.scenes.dtu_cameras import read_cameras
from framework.scenes.formats import listed
from framework.scenes.images import list_images, photo_folder
from framework.scenes.layout import FolderScene, Listing
from framework.scenes.model_points import colmap_tracks
from framework.scenes.photo import Photo
from framework.scenes.splits import Split, protocol

log = logging.getLogger(__name__)

POSITION = re.compile(r"(\d{1,9})|rect_(\d{3})_3_r5000", re.ASCII)
TRAIN_MASKS = ("background", "full", "object")
NEAR_MM, FAR_MM = 425.0, 935.0
USUAL_WIDTH = 400
DARK, DARK_SCAN_110 = 30, 15  # grey values below which a pixel may be background
MOST = 1000  # positions


@dataclass(frozen=True)
class Dtu(FolderScene):
    """Options of `scene=dtu`.

    Attributes:
        near, far: depth bounds in millimetres.
    """

    layout: ClassVar[str] = "dtu"

    n_views: int | str = 3  # training views; all = every one that is not for testing
    downscale: int | None = None  # photos are reduced by it; null = to 400 x 300
    near: float = NEAR_MM
    far: float = FAR_MM
    split: str = "dtu"  # which views train and which test: llff, mip360, dtu; none = no test
    scan: int | None = None  # which scan, where path is a folder of scans
    images: str = "auto"  # folder of the photos; auto = images where there is one, else image
    model: str = "auto"  # folder of the COLMAP model inside path; auto = that of the most photos
    train_mask: str = "background"  # what of the training photos counts: background, full, object

    def __post_init__(self) -> None:
        super().__post_init__()
        self.expect_choice("train_mask", TRAIN_MASKS)

    def listing(self, folder: Path) -> Listing:
        folder = scan_folder(folder, self.scan)
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
        dark = DARK_SCAN_110 if folder.name.endswith("scan110") else DARK
        photos = [
            Photo(
                file,
                file.name,
                cameras[i].lens,
                cameras[i].viewmat,
                masks[i] if i in split.test or self.train_mask == "object" else None,
                dark=dark if i in split.train and self.train_mask == "background" else None,
            )
            for i, file in files.items()
        ]
        names, viewmats = [photo.name for photo in photos], [photo.viewmat for photo in photos]
        return Listing(
            folder.name,
            where,
            viewmats,
            photos.__getitem__,
            split.among([*files]),
            colmap_tracks(folder, "the cameras' file", names, viewmats, self.model),
            self.near,
            self.far,
        )

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

    def usual_downscale(self, photo: Path) -> int:
        """The factor that makes photos 400 pixels wide."""
        width, height = image_size(photo, PHOTO_PIXELS)
        factor = max(1, round(width / USUAL_WIDTH))
        if width != factor * USUAL_WIDTH:
            log.warning(
                f"{photo}: photos of {width}x{height} are reduced to {width // factor}x"
                f"{height // factor}, not the 400x300 of the usual protocol; for that use photos"
                " of 1600x1200 or 800x600"
            )
        return factor


def scan_folder(folder: Path, scan: int | None) -> Path:
    """The folder of the scan in `folder`, which is that scan or holds several.

    Raises:
        UserError: for an unknown one, with a list of all.
    """
    folder = folder.resolve()
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


def _numbered(folder: Path) -> dict[int, Path]:
    """The images of `folder` by the rig position in their names, from 0."""
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
