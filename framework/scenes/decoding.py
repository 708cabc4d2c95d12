"""Decoding image files by Pillow: formats, size limits, kinds of channels, EXIF orientations."""

from __future__ import annotations

import io
import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from framework.errors import UserError, require
from framework.files.limits import IMAGE_PIXELS, PHOTO_BYTES, check_pixels
from framework.files.opened import read_bytes
from framework.scenes.formats import FORMAT_NAMES, FORMATS, pillow_formats, signature

if TYPE_CHECKING:
    from PIL import Image

_FILTERS = threading.Lock()  # threads read images, but warning filters are global
EIGHT_BIT = {"1", "L", "LA", "P", "PA", "RGB", "RGBA", "CMYK", "YCbCr"}
ORIENTATION = 0x0112  # EXIF tag
TURNS: dict[int, str] = {  # EXIF orientation -> Pillow's transposition that makes a photo upright
    **{2: "FLIP_LEFT_RIGHT", 3: "ROTATE_180", 4: "FLIP_TOP_BOTTOM", 5: "TRANSPOSE"},
    **{6: "ROTATE_270", 7: "TRANSVERSE", 8: "ROTATE_90"},
}
SIDEWAYS = {5, 6, 7, 8}  # orientations that exchange width and height
DARKEST = 16  # of 255; a 16-bit photo below it probably has 12-bit values
DAMAGED = (OSError, SyntaxError, ValueError, EOFError)  # raised by Pillow; the last for HEIC


@contextmanager
def opened(path: Path, most: int = IMAGE_PIXELS) -> Iterator[Image.Image]:
    """Open an image and decode its header.

    Images of more than `most` pixels are refused, also small files that would unpack to them.
    Pillow gets bytes, not the file: for a file it allocates whatever length a damaged header has.

    Raises:
        UserError: for whatever is wrong.
    """
    from PIL import Image

    stored = io.BytesIO()
    try:
        formats = pillow_formats(path)
        stored = io.BytesIO(read_bytes(path, PHOTO_BYTES))
        with _FILTERS, warnings.catch_warnings():
            # Pillow warns of large images, which are refused here, and of damaged metadata
            warnings.simplefilter("ignore")
            image = Image.open(stored, formats=formats)
        with image:
            check_pixels(path, *image.size, most)
            yield image
    except (*DAMAGED, Image.DecompressionBombError) as error:
        if isinstance(error, UserError):
            raise
        kind = signature(stored.getvalue()[:12])
        if kind is not None and kind not in FORMATS:
            raise UserError(
                f"{path}: expected a readable image in {FORMAT_NAMES}, got {kind}; convert it to"
                " JPEG or PNG"
            ) from None
        reason = re.sub(r"<_io\.BytesIO.*?>|\s+", " ", str(error).replace(str(path), "")).strip(
            " '"
        )
        raise UserError(
            f"{path}: expected a readable image, got a damaged file ({reason}); replace it"
        ) from None


class Header(NamedTuple):
    """Width and height in pixels as stored, and the EXIF orientation (1 to 8; 1 is upright)."""

    width: int
    height: int
    orientation: int


def image_header(path: Path, most: int = IMAGE_PIXELS) -> Header:
    """Read the header of an image of at most `most` pixels."""
    with opened(path, most) as image:
        return Header(*_stored_size(image), orientation(image))


def image_size(path: Path, most: int = IMAGE_PIXELS) -> tuple[int, int]:
    """(width, height) as stored, from the file's header."""
    return image_header(path, most)[:2]


def orientation(image: Image.Image) -> int:
    """The EXIF orientation of an image that is not loaded yet; 1 without a valid one."""
    value = exif_of(image).get(ORIENTATION, 1)
    return value if value in TURNS else 1


def exif_of(image: Image.Image) -> Image.Exif:
    """The EXIF tags of an image; none if they are damaged."""
    from PIL import Image

    with _FILTERS, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return image.getexif()
        except (*DAMAGED, KeyError, TypeError):
            return Image.Exif()


def _stored_size(image: Image.Image) -> tuple[int, int]:
    """(width, height) as stored; newer versions of Pillow swap them for a turned TIFF."""
    tags = getattr(image, "tag_v2", None)
    return image.size if tags is None else (int(tags[256]), int(tags[257]))


def has_16_bits(image: Image.Image) -> bool:
    """Whether an image, not loaded yet, has 16 bits per channel. Pillow keeps the upper byte of
    several channels."""
    stored = [str(tile[3]) for tile in getattr(image, "tile", ()) if len(tile) > 3]
    return image.mode.startswith("I;16") or any(";16" in name for name in stored)


def eight_bit(path: Path, image: Image.Image) -> Image.Image:
    """Load an image with 8 bits per channel.

    Raises:
        UserError: for floats and 32-bit integers.
    """
    import numpy as np
    from PIL import Image

    deep = has_16_bits(image)
    image.load()
    if image.mode.startswith("I;16"):
        image = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
    require(
        image.mode in EIGHT_BIT,
        f"{path}: expected 8 or 16 bits per channel in grey, RGB or CMYK, got mode {image.mode};"
        " convert it to 8-bit RGB",
    )
    if deep:
        brightest = max(high for _, high in _extrema(image.convert("RGB")))
        require(
            not 0 < brightest < DARKEST,
            f"{path}: expected values up to 65,535 in a 16-bit photo, got at most"
            f" {256 * brightest + 255:,}, as of a sensor of 12 bits; scale them to 8 or 16 bits",
        )
    return image


def _extrema(image: Image.Image) -> list[tuple[float, float]]:
    """(lowest, highest) value of each channel of an RGB image."""
    return [channel.getextrema() for channel in image.split()]  # type: ignore[misc]


def turned(image: Image.Image, orientation: int) -> Image.Image:
    """Make an image upright. Pillow's `exif_transpose` would fail on damaged EXIF."""
    from PIL.Image import Transpose

    return image.transpose(Transpose[TURNS[orientation]]) if orientation in TURNS else image
