"""Image files of a scene: listing and reading.

Pixels are 8-bit RGB; 16-bit values lose their lower byte. EXIF orientations are applied only where
`photo` requires it: structure from motion mostly ignores them, so poses belong to stored pixels.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.limits import IMAGE_PIXELS, PHOTO_PIXELS
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.decoding import eight_bit, opened, orientation, turned
from framework.scenes.formats import SUFFIXES, is_photo, listed, unread_files, warn_left_out

AUTO = "auto"  # let the loader choose a folder
# folders of photos: an eighth, as in sparse-view benchmarks, else full size
EIGHTH_OR_FULL = ("images_8", "images")
MASK_STRETCH = 1.02  # largest ratio of the two axes' scales of a resized mask


def scene_folder(loader: str, path: str) -> Path:
    """The scene's folder.

    Raises:
        UserError: if there is none.
    """
    folder = Path(path).expanduser()
    require(
        folder.is_dir(),
        f"scene={loader}: expected a folder at '{path}', found"
        f" {'a file' if folder.exists() else 'nothing'}; correct scene.path",
    )
    real = folder.resolve()
    if real.name:
        inside(real.parent, real.name)  # it names the scene in records
    return folder


def list_images(folder: Path) -> list[Path]:
    """List the photos of `folder` by name; warn about pictures in other formats.

    Raises:
        UserError: there are none, or one is a link that leads out of the folder.
    """
    entries = sorted(folder.glob("*")) if folder.is_dir() else []
    images = [inside(folder, path.name) for path in entries if is_photo(path)]
    unread = unread_files(folder) if entries else []
    if not images:
        what = "no image in it" if folder.is_dir() else "no such folder"
        what += f" but {listed(unread)}" if unread else ""
        raise UserError(
            f"{folder}: expected a folder of {', '.join(sorted(SUFFIXES))} images, got {what};"
            " put the images there or choose another folder"
        )
    warn_left_out(str(folder), unread)
    return images


def photo_folder(loader: str, folder: Path, images: str, names: Sequence[str], layout: str) -> Path:
    """The folder of a scene's photos.

    Args:
        loader: for messages.
        folder: the scene.
        images: `scene.images`; "auto" is the first of `names` that exists.
        names: the layout's folders of photos.
        layout: the layout's other files, for messages.
    """
    if images != AUTO:
        return inside(folder, images)
    for name in names:
        if (folder / name).is_dir():
            return inside(folder, name)
    raise UserError(
        f"scene={loader}: expected {'/ or '.join(names)}/ with the photos, and {layout}, in"
        f" '{folder}', found no folder of photos; correct scene.path, or set scene.images"
    )


def read_image(path: Path, factor: int = 1, turn: int = 1) -> NDArray[np.uint8]:
    """Read an opaque image.

    Args:
        path: the file; one of more than `IMAGE_PIXELS` needs a factor above 1.
        factor: reduces the image while it is read, by box means.
        turn: the EXIF orientation to apply; 1 keeps the pixels as stored.

    Returns:
        [H, W, 3] uint8.

    Raises:
        UserError: the file is damaged, or has another kind of channels, or transparency.
    """
    rgb, alpha = _pixels(path, factor, turn)
    require(alpha is None, f"{path}: expected an opaque image, got transparency; flatten it")
    return rgb


def read_masked(
    path: Path, mask: Path | None, factor: int = 1, turn: int = 1, paper: int | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.float32] | None, bool]:
    """Read a photo and its mask.

    Args:
        path: the photo.
        mask: a picture, black where the photo does not count.
        factor: see `read_image`; for both.
        turn: see `read_image`; for the photo.
        paper: grey value 0 to 255 behind a transparent photo; alpha blends the stored (sRGB)
            values, as for the NeRF synthetic data set.

    Returns:
        Pixels [H, W, 3]; a mask [H, W], or None if all pixels count; and whether the photo is
        transparent. The mask is 0 where `mask` is black, and, without paper, where alpha is below
        one half.

    Raises:
        UserError: a file is damaged, the mask has another shape, no pixel counts, or the photo is
            transparent everywhere.
    """
    rgb, alpha = _pixels(path, factor, turn)
    height, width = rgb.shape[:2]
    valid = None if mask is None else read_mask(mask, height, width, factor)
    if alpha is not None and paper is None:
        opaque = (alpha >= 128).astype(np.float32)
        valid = opaque if valid is None else valid * opaque
    elif alpha is not None:
        for row, a in zip(rgb, alpha, strict=True):  # by rows to save memory
            share = a[:, None].astype(np.float64) / 255.0
            row[:] = np.rint(row * share + float(paper or 0) * (1.0 - share))
    blank = alpha is not None and not alpha.any()
    require(
        not blank and (valid is None or bool(valid.any())),
        f"{path if blank or mask is None else mask}: expected some white pixels in a mask, or some"
        " that are not transparent in a photo, got none; replace it",
    )
    return rgb, valid, alpha is not None


def _pixels(
    path: Path, factor: int, turn: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None]:
    """([H, W, 3], [H, W] alpha or None where every pixel is opaque)."""
    with opened(path, PHOTO_PIXELS if factor > 1 else IMAGE_PIXELS) as stored:
        # Pillow turns a TIFF when it loads it; this is undone
        by_pillow = orientation(stored) if stored.format == "TIFF" else 1
        image = eight_bit(path, stored)
        clear = image.has_transparency_data
        mode = "RGBA" if clear else "RGB"
        image = image if image.mode == mode else image.convert(mode)
        image = turned(turned(image, {6: 8, 8: 6}.get(by_pillow, by_pillow)), turn)
        if factor > 1:  # without an incomplete last row or column
            width, height = (side // factor * factor for side in image.size)
            image = image.reduce(factor, (0, 0, width, height))
        pixels = np.asarray(image, dtype=np.uint8)
    if not clear:
        return pixels, None
    rgb, alpha = pixels[..., :3].copy(), pixels[..., 3]
    require(
        factor == 1 or alpha.min() == 255,
        f"{path}: expected an opaque photo above {IMAGE_PIXELS:,} pixels, got transparency;"
        " reduce it, or lay it on a background",
    )
    return rgb, None if alpha.min() == 255 else alpha


def read_mask(path: Path, height: int, width: int, factor: int = 1) -> NDArray[np.float32]:
    """Read a mask [H, W] float32: 1 where the first channel is at least half of white, else 0.

    A mask of another size is resized. factor: see `read_image`.

    Raises:
        UserError: the file is missing or damaged, or has other proportions.
    """
    import cv2

    require(is_file(path), f"{path}: expected a mask, found no file; restore it")
    grey = read_image(path, factor)[..., 0]
    stretch = grey.shape[1] / width * height / grey.shape[0]
    require(
        1 / MASK_STRETCH <= stretch <= MASK_STRETCH,
        f"{path}: expected a mask of the photo's {width}x{height} pixels or of that shape, got"
        f" {grey.shape[1]}x{grey.shape[0]}; resize it",
    )
    if grey.shape != (height, width):
        grey = np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA))
    return (grey >= 128).astype(np.float32)
