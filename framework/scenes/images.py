"""Image files of a scene: listing and reading. Pixels are 8-bit RGB as stored, EXIF turns ignored
(structure from motion ignores them too, so the poses belong to the stored pixels).
"""

from __future__ import annotations

import io
import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require
from framework.files.limits import IMAGE_BYTES, check_pixels
from framework.files.opened import is_file, read_bytes
from framework.files.paths import inside

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from PIL import Image

AUTO = "auto"
# of photos: the usual size of the sparse-view benchmarks, an eighth, and the full one
EIGHTH_OR_FULL = ("images_8", "images")
SUFFIXES = {".png", ".jpg", ".jpeg"}
FORMATS = ("PNG", "JPEG")  # whatever the suffix says; Pillow knows many more, some run programs
MASK_STRETCH = 1.02  # by which the two axes of a resized mask may differ
_FILTERS = threading.Lock()  # of warnings are the process's, and threads read images
EIGHT_BIT = {"L", "P", "RGB", "RGBA", "LA"}


def scene_folder(loader: str, path: str) -> Path:
    """The scene's folder. Raises UserError if it is none."""
    folder = Path(path).expanduser()
    require(
        folder.is_dir(),
        f"scene={loader}: expected a folder at '{path}', found"
        f" {'a file' if folder.exists() else 'nothing'}; correct scene.path",
    )
    real = folder.resolve()
    if real.name:
        inside(real.parent, real.name)  # a text: it names the scene in records
    return folder


def list_images(folder: Path) -> list[Path]:
    """The image files of `folder`, sorted by name. Raises UserError if there are none, or if one is
    a link that leads out of the folder."""
    found = sorted(folder.glob("*")) if folder.is_dir() else []
    named = [p for p in found if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    images = [inside(folder, p.name) for p in named]
    if not images:
        what = "no image in it" if folder.is_dir() else "no such folder"
        raise UserError(
            f"{folder}: expected a folder of {', '.join(sorted(SUFFIXES))} images, got {what};"
            " put the images there or choose another folder"
        )
    return images


def photo_folder(loader: str, folder: Path, images: str, names: Sequence[str], beside: str) -> Path:
    """The folder of the photos inside a scene's: `images`, or for "auto" the first of `names` that
    is there. Raises UserError if none is, with the layout: beside is what else belongs to it."""
    if images != AUTO:
        return inside(folder, images)
    for name in names:
        if (folder / name).is_dir():
            return inside(folder, name)
    raise UserError(
        f"scene={loader}: expected {'/ or '.join(names)}/ with the photos, and {beside}, in"
        f" '{folder}', found no folder of photos; correct scene.path, or set scene.images"
    )


DAMAGED = (OSError, SyntaxError, ValueError, EOFError)  # what Pillow raises; the last for HEIC


@contextmanager
def opened(path: Path, formats: tuple[str, ...] = FORMATS) -> Iterator[Image.Image]:
    """The image, of which only the header was decoded: its size is within `limits`, also that of a
    small file that would unpack to a huge image. Whatever is wrong raises UserError.

    Pillow gets the bytes and not the file: of a file it allocates what a damaged length asks for.
    """
    from PIL import Image

    try:
        stored = io.BytesIO(read_bytes(path, IMAGE_BYTES))
        with _FILTERS, warnings.catch_warnings():
            # Pillow warns of large images, which are refused here
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            image = Image.open(stored, formats=formats)
        with image:
            check_pixels(path, *image.size)
            yield image
    except (*DAMAGED, Image.DecompressionBombError) as error:
        if isinstance(error, UserError):
            raise
        reason = re.sub(r"<_io\.BytesIO.*?>|\s+", " ", str(error).replace(str(path), "")).strip(
            " '"
        )
        raise UserError(
            f"{path}: expected a readable image, got a damaged file ({reason}); replace it"
        ) from None


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) from the file's header."""
    with opened(path) as image:
        return image.size


def bits(image: Image.Image) -> str:
    """Pillow's mode of an image that is not loaded yet, or of what is stored where that has 16 bits
    per channel: Pillow cuts them off without a word."""
    stored = [str(tile[3]) for tile in getattr(image, "tile", ()) if len(tile) > 3]
    deep = [name for name in stored if ";16" in name]
    return deep[0] if deep and image.mode in EIGHT_BIT else image.mode


def read_image(path: Path) -> NDArray[np.uint8]:
    """[H, W, 3] uint8. Raises UserError for a damaged, deeper than 8-bit or transparent image."""
    rgb, alpha = _pixels(path)
    require(alpha is None, f"{path}: expected an opaque image, got transparency; flatten it")
    return rgb


def read_on_paper(path: Path, paper: int) -> tuple[NDArray[np.uint8], bool]:
    """([H, W, 3] uint8, whether the image is transparent). paper: the grey value 0 to 255 that it
    is laid on, alpha blending the stored (sRGB) values as the NeRF synthetic data set is used.

    Raises UserError for a damaged or deeper than 8-bit image.
    """
    import numpy as np

    rgb, alpha = _pixels(path)
    if alpha is None:
        return rgb, False
    for row, opaque in zip(rgb, alpha, strict=True):  # by rows: float64 takes eight times as much
        share = opaque[:, None].astype(np.float64) / 255.0
        row[:] = np.rint(row * share + float(paper) * (1.0 - share))
    return rgb, True


def read_masked(
    path: Path, mask: Path | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None]:
    """Read a photo and its mask.

    Returns:
        Pixels [H, W, 3], and a mask [H, W] that is 0 where the photo is transparent (alpha below
        one half) or `mask` is black; None where neither is given.

    Raises:
        UserError: a file is damaged, the mask has another shape, or no pixel counts.
    """
    import numpy as np

    rgb, alpha = _pixels(path)
    valid = None if alpha is None else (alpha >= 128).astype(np.float32)
    if mask is not None:
        white = read_mask(mask, *rgb.shape[:2])
        valid = white if valid is None else valid * white
    require(
        valid is None or bool(valid.any()),
        f"{mask or path}: expected some white pixels in a mask, or some that are not transparent in"
        " a photo, got none; replace it",
    )
    return rgb, valid


def _pixels(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """([H, W, 3], [H, W] alpha or None where every pixel is opaque), as stored."""
    import numpy as np

    with opened(path) as image:
        kind = bits(image)
        image.load()
        require(
            kind in EIGHT_BIT, f"{path}: expected 8 bits per channel, got mode {kind}; convert it"
        )
        clear = image.has_transparency_data
        pixels = np.asarray(image.convert("RGBA" if clear else "RGB"), dtype=np.uint8)
    if not clear:
        return pixels, None
    rgb, alpha = pixels[..., :3].copy(), pixels[..., 3]
    return rgb, None if alpha.min() == 255 else alpha


def read_mask(path: Path, height: int, width: int) -> NDArray[np.float32]:
    """[H, W] float32, 1 where the first channel is at least one half of white, else 0.

    A mask of another size is resized. Raises UserError for a missing or damaged file or one of
    another shape.
    """
    import cv2
    import numpy as np

    require(is_file(path), f"{path}: expected a mask, found no file; restore it")
    grey = read_image(path)[..., 0]
    stretch = grey.shape[1] / width * height / grey.shape[0]
    require(
        1 / MASK_STRETCH <= stretch <= MASK_STRETCH,
        f"{path}: expected a mask of the photo's {width}x{height} pixels or of that shape, got"
        f" {grey.shape[1]}x{grey.shape[0]}; resize it",
    )
    if grey.shape != (height, width):
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA))
    return (grey >= 128).astype(np.float32)


def resize_ratio(model: int, image: int) -> float | None:
    """Factor from camera pixels to image pixels along one axis; None if `image` is neither `model`
    nor `model` times or over an integer (rounded either way, as resizers do)."""
    if model == image:
        return 1.0
    large, small = max(model, image), min(model, image)
    if abs(large / round(large / small) - small) < 1 and round(large / small) > 1:
        return image / model
    return None
