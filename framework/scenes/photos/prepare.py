"""Prepares photos for the search and the training, and groups them by camera.

Prepared photos are upright, at most `side` pixels long, and 8-bit RGB in JPEG or PNG (RGBA if they
are partly transparent).

The focal length in pixels is from EXIF (CIPA DC-008). The 35 mm equivalent compares diagonals,
43.27 mm on film. Without it, it is the focal length in mm times the sensor's pixels per mm.
"""

from __future__ import annotations

import logging
import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from framework.files.limits import PHOTO_PIXELS
from framework.scenes.decoding import eight_bit, exif_of, has_16_bits, opened, orientation, turned

if TYPE_CHECKING:
    from PIL import Image

FILM_DIAGONAL_MM = 43.27
MAKE, MODEL, EXIF = 0x010F, 0x0110, 0x8769
FOCAL_MM, FOCAL_35MM, PLANE_X, PLANE_UNIT, PIXELS = 0x920A, 0xA405, 0xA20E, 0xA210, (0xA002, 0xA003)
UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0}  # inch, cm, mm

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Photo:
    """A prepared photo.

    Attributes:
        name: of the file, for messages.
        stored: name of the prepared file.
        focal_px: from EXIF, None without.
        camera: photos with equal values share a camera.
    """

    name: str
    stored: str
    width: int
    height: int
    focal_px: float | None
    camera: tuple[object, ...]
    reduced: bool


def prepare(file: Path, folder: Path, number: int, side: int) -> Photo:
    """Store the photo in `folder`.

    Raises:
        UserError: for one that cannot be used.
    """
    with opened(file, PHOTO_PIXELS) as image:
        exif, size, kind = exif_of(image), image.size, image.format
        turn = orientation(image) if kind != "TIFF" else 1  # Pillow turns these itself
        deep = has_16_bits(image)
        clear = _is_transparent(image)
        reduced = max(size) > side
        plain = turn == 1 and image.mode in ("RGB", "L") and not deep
        as_is = not reduced and plain and kind in ("PNG", "JPEG")
        suffix = ".png" if kind in ("PNG", "TIFF", "BMP") or clear else ".jpg"
        stored = folder / f"{number:06d}{suffix}"
        if as_is:
            image.load()  # refuses a damaged photo
            shutil.copyfile(file, stored)
            width, height = size
        else:
            image = eight_bit(file, image) if deep or image.mode not in ("RGB", "L") else image
            width, height = _store(image, turn, side, stored, "RGBA" if clear else "RGB")
        focal = _focal_px(exif, size)
    scale = max(width, height) / max(size)
    camera = (width, height, exif.get(MAKE), exif.get(MODEL), None if not focal else round(focal))
    return Photo(
        _shown(file, suffix), stored.name, width, height, focal and focal * scale, camera, reduced
    )


def _is_transparent(image: Image.Image) -> bool:
    alpha: Any = image.convert("RGBA").getchannel("A") if image.has_transparency_data else None
    return alpha is not None and alpha.getextrema()[0] < 255


def _store(image: Image.Image, turn: int, side: int, path: Path, mode: str) -> tuple[int, int]:
    """Write the reduced, upright image and return its size."""
    from PIL.Image import Resampling

    if image.mode not in (mode, "L"):  # Pillow does not filter palettes
        image = image.convert(mode)
    image.thumbnail((side, side), Resampling.LANCZOS, reducing_gap=3.0)  # a JPEG is read reduced
    upright = turned(image.convert(mode), turn)
    for key in ("exif", "icc_profile", "xmp"):
        upright.info.pop(key, None)
    if path.suffix == ".png":
        upright.save(path, compress_level=1)
    else:
        upright.save(path, quality=95, subsampling=0)
    return upright.size


def _shown(file: Path, suffix: str) -> str:
    """The photo's name in the scene, with `suffix` if its format changed."""
    same = {".jpg": (".jpg", ".jpeg"), ".png": (".png",)}[suffix]
    return file.name if file.suffix.lower() in same else f"{file.name}{suffix}"


def _focal_px(exif: Any, size: tuple[int, int]) -> float | None:
    """Focal length in pixels of the photo of `size`; None without sensible EXIF."""
    try:
        tags = exif.get_ifd(EXIF)
        film = float(tags.get(FOCAL_35MM) or 0)
        if film > 0:
            focal = film / FILM_DIAGONAL_MM * math.hypot(*size)
        else:
            per_mm = float(tags.get(PLANE_X) or 0) / UNIT_MM.get(tags.get(PLANE_UNIT, 2), 25.4)
            taken = max(float(tags.get(side) or 0) for side in PIXELS)
            resized = max(size) / (taken or max(size))  # of the longer sides
            focal = float(tags.get(FOCAL_MM) or 0) * per_mm * resized
    except (ValueError, TypeError, ZeroDivisionError, KeyError, OSError, SyntaxError) as error:
        log.debug("EXIF without a usable focal length: %s", error)
        return None
    return focal if 0.2 * max(size) < focal < 20 * max(size) else None
