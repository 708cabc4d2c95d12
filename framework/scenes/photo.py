"""From a stored photo and its camera to a `Shot`: undistorted, then box-downscaled.

A photo may have another size than its camera if the proportions are the same; K is scaled. Photos
are read one at a time and reduced at once. The memory of the reduced views is checked from the file
headers before the first photo is decoded.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.limits import IMAGE_PIXELS, PHOTO_PIXELS, SCENE_BYTES
from framework.scenes.assemble import Shot, intrinsics
from framework.scenes.decoding import SIDEWAYS, image_header, image_size
from framework.scenes.images import read_masked
from framework.scenes.lens import PINHOLE, Distortion, Lens, undistort
from framework.scenes.splits import Split

BYTES_PER_PIXEL = 12  # three float32
DARK_RUN = 50  # pixels: a background pixel and those above it
REACH = 6  # pixels from which undistortion mixes a pixel: half of 8, and overshoots


@dataclass(frozen=True)
class Photo:
    """A photo that is not read yet, and its camera.

    Attributes:
        viewmat: [4, 4] world-to-camera.
        mask: a picture, black where the photo does not count.
        sized: the lens' size is stated elsewhere than by the photo.
        dark: grey value below which pixels may be `background`, which does not count; None if
            there is none.
    """

    file: Path
    name: str
    lens: Lens
    viewmat: NDArray[np.float64]
    mask: Path | None = None
    sized: bool = True
    dark: int | None = None


def read_shots(
    photo_at: Callable[[int], Photo], split: Split, downscale: int, paper: int | None = None
) -> tuple[list[Shot], list[Shot]]:
    """Read the training and the test photos of a split; `photo_at` takes their indices."""
    train, test = ([photo_at(i) for i in part] for part in (split.train, split.test))
    check_memory([photo.file for photo in (*train, *test)], downscale)
    shots = [read_shot(photo, downscale, paper) for photo in (*train, *test)]
    return shots[: len(train)], shots[len(train) :]


def check_memory(files: Sequence[Path], downscale: int) -> None:
    """Raise UserError if the downscaled images would take more than 4 GiB, or if one is too large
    to be read at full size."""
    pixels = 0
    for file in files:
        width, height = image_size(file, PHOTO_PIXELS)
        require(
            downscale > 1 or width * height <= IMAGE_PIXELS,
            f"{file}: expected a photo of at most {IMAGE_PIXELS:,} pixels with scene.downscale=1,"
            f" got {width}x{height}; set scene.downscale=2 or more",
        )
        pixels += (width // downscale) * (height // downscale)
    need = pixels * BYTES_PER_PIXEL
    require(
        need <= SCENE_BYTES,
        f"{files[0].parent}: expected images of at most {SCENE_BYTES >> 30} GiB in all, got"
        f" {need / 2**30:.1f} GiB ({len(files)} views); raise scene.downscale (now {downscale})",
    )


def check_content(shots: Sequence[Shot], where: str) -> None:
    """Raise UserError if each of the photos has one colour, so that nothing in them can match."""
    require(
        any(bool((shot.image != shot.image[0, 0]).any()) for shot in shots),
        f"{where}: expected training photos that show something, got {len(shots)} of one colour"
        f" each (first: {shots[0].name}); replace the photos, or check what exported them",
    )


def read_shot(photo: Photo, downscale: int = 1, paper: int | None = None) -> Shot:
    """Read a photo, undistort and reduce it.

    Args:
        photo: with its camera.
        downscale: `scene.downscale`.
        paper: grey value behind a transparent photo; None masks transparent pixels.

    Raises:
        UserError: a file is damaged, or the photo has other proportions than the camera, also with
            its EXIF orientation.
    """
    lens = photo.lens
    width, height, orientation = image_header(photo.file, PHOTO_PIXELS)
    upright = (height, width) if orientation in SIDEWAYS else (width, height)
    as_stored, as_upright = resize_scale(lens, width, height), resize_scale(lens, *upright)
    turn = orientation if as_stored is None and as_upright is not None else 1
    doubtful = orientation != 1 and (as_upright is not None or not photo.sized)
    scale = as_stored or as_upright
    if scale is None:
        exif = f" and EXIF orientation {orientation}" if orientation != 1 else ""
        raise UserError(
            f"{photo.file}: expected the camera's {lens.width}x{lens.height} pixels or a photo of"
            f" the same proportions, got {width}x{height}{exif}; use the photos that the poses were"
            " found from, or choose another scene.images"
        )
    sx, sy = scale
    factor = downscale if width * height > IMAGE_PIXELS else 1  # reduces very large photos at once
    K = intrinsics(lens.fx * sx, lens.fy * sy, lens.cx * sx, lens.cy * sy)
    K[:2] /= factor
    image, valid, clear = read_masked(photo.file, photo.mask, factor, turn, paper)
    shot = _undistorted(Shot(photo.name, photo.viewmat, K, image, mask=valid), lens.distortion)
    shot = downscaled(shot, downscale // factor, share=1.0 if shot.lens else 0.5)
    if photo.dark is not None:
        kept = 1 - background(shot.image, photo.dark)
        shot = replace(shot, mask=kept if shot.mask is None else kept * shot.mask)
    exif_turn = (orientation, turn != 1) if doubtful else None
    return replace(shot, exif=exif_turn, clear=clear and paper is not None)


def background(image: NDArray[np.uint8], level: int) -> NDArray[np.float32]:
    """Find the dark surroundings of the table.

    Returns:
        [H, W] float32, 1 for pixels of `image` [H, W, 3] that are darker than `level` in every
        channel, if the DARK_RUN - 1 pixels above (as far as the image reaches) are too.
    """
    dark = image.max(axis=2) < level
    rows = np.arange(len(dark))[:, None]
    last_bright = np.maximum.accumulate(np.where(dark, -DARK_RUN, rows), axis=0)
    return (rows - last_bright >= DARK_RUN).astype(np.float32)


def resize_scale(lens: Lens, width: int, height: int) -> tuple[float, float] | None:
    """Factors from camera to image pixels along x and y.

    None if no single factor explains both sides, each rounded to a whole pixel either way.
    """
    sx, sy = width / lens.width, height / lens.height
    slack = max(1.0, sx, sy) * (1 / lens.width + 1 / lens.height)
    return (sx, sy) if abs(sx - sy) < slack else None


def _undistorted(shot: Shot, distortion: Distortion) -> Shot:
    if distortion == PINHOLE:
        return shot
    image, covered = undistort(shot.image, shot.K, distortion)
    if shot.mask is not None:  # pixels that are mixed from valid ones only
        import cv2

        white = cv2.erode((255 * shot.mask).astype(np.uint8), np.ones((2 * REACH + 1,) * 2))
        kept, _ = undistort(np.repeat(white[..., None], 3, axis=2), shot.K, distortion)
        whole = (kept[..., 0] == 255).astype(np.float32)
        covered = whole if covered is None else covered * whole
    return replace(shot, image=image, mask=covered, lens=distortion.terms)


def downscaled(shot: Shot, factor: int, share: float = 0.5) -> Shot:
    """Box means over factor x factor pixels; an incomplete last row or column is cut.

    Args:
        share: the part of a box that must be valid for its mean to be valid.
    """
    if factor == 1:
        return shot
    require(
        min(shot.image.shape[:2]) >= factor,
        f"{shot.name}: expected an image of at least {factor}x{factor} pixels, got"
        f" {shot.image.shape[1]}x{shot.image.shape[0]}; lower scene.downscale",
    )
    K = shot.K.copy()
    K[:2] /= factor
    image = np.rint(_box_mean(shot.image, factor)).astype(np.uint8)
    mask = shot.mask
    if mask is not None:
        mask = (_box_mean(mask[..., None], factor)[..., 0] >= share).astype(np.float32)
    return replace(shot, K=K, image=image, mask=mask)


def _box_mean(pixels: NDArray, factor: int) -> NDArray[np.float64]:
    """[H // f, W // f, C] means of [H, W, C]."""
    h, w, channels = pixels.shape[0] // factor, pixels.shape[1] // factor, pixels.shape[2]
    boxes = pixels[: h * factor, : w * factor].reshape(h, factor, w, factor, channels)
    means: NDArray[np.float64] = boxes.mean(axis=(1, 3), dtype=np.float64)
    return means
