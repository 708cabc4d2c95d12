"""From a stored photo and its camera to a `Shot`: undistorted, then box-downscaled.

A photo may have another size than its camera, if the proportions are the same; K is scaled.

Photos are read one at a time and reduced at once, so a scene never needs much more memory than its
reduced views; what those need is checked from the file headers before the first photo is decoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.errors import UserError, require
from framework.files.limits import IMAGE_PIXELS, PHOTO_PIXELS, SCENE_BYTES
from framework.scenes.assemble import Shot, intrinsics
from framework.scenes.decoding import SIDEWAYS, image_header, image_size
from framework.scenes.images import read_masked
from framework.scenes.lens import PINHOLE, Distortion, Lens, undistort

if TYPE_CHECKING:
    from numpy.typing import NDArray

BYTES_PER_PIXEL = 12  # three float32
REACH = 6  # pixels from which taking a lens out mixes a pixel: half of 8, and what overshoots


def check_memory(files: Sequence[Path], downscale: int) -> None:
    """Raise UserError if the downscaled images would take more than 4 GiB, or one is too large to
    be read without reducing it."""
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


@dataclass(frozen=True)
class Reading:
    """How to read a photo.

    Attributes:
        K: [3, 3] intrinsics of the pixels that are read.
        factor: by which the photo is reduced while it is read; 1 unless it is very large.
        turn: EXIF orientation to apply; 1 for none.
        exif: see `Shot`.
    """

    K: NDArray[np.float64]
    factor: int = 1
    turn: int = 1
    exif: tuple[int, bool] | None = None


def reading(file: Path, lens: Lens, downscale: int, sized: bool = True) -> Reading:
    """Decide how to read the photo of a camera.

    Args:
        file: the photo.
        lens: its camera.
        downscale: `scene.downscale`.
        sized: whether the lens' size is known from elsewhere than the photo.

    Raises:
        UserError: the photo has other proportions than the camera, also with its EXIF orientation.
    """
    width, height, orientation = image_header(file, PHOTO_PIXELS)
    upright = (height, width) if orientation in SIDEWAYS else (width, height)
    scale, upright_scale = resize_scale(lens, width, height), resize_scale(lens, *upright)
    turn = orientation if scale is None and upright_scale is not None else 1
    doubtful = orientation != 1 and (upright_scale is not None or not sized)
    scale = scale or upright_scale
    if scale is None:
        exif = f" and EXIF orientation {orientation}" if orientation != 1 else ""
        raise UserError(
            f"{file}: expected the camera's {lens.width}x{lens.height} pixels or a photo of the"
            f" same proportions, got {width}x{height}{exif}; use the photos that the poses were"
            " found from, or choose another scene.images"
        )
    sx, sy = scale
    K = intrinsics(lens.fx * sx, lens.fy * sy, lens.cx * sx, lens.cy * sy)
    factor = downscale if width * height > IMAGE_PIXELS else 1
    K[:2] /= factor
    return Reading(K, factor, turn, (orientation, turn != 1) if doubtful else None)


def resize_scale(lens: Lens, width: int, height: int) -> tuple[float, float] | None:
    """Factors from camera to image pixels along x and y.

    None if no single factor explains both sides, each rounded to a whole pixel either way.
    """
    sx, sy = width / lens.width, height / lens.height
    slack = max(1.0, sx, sy) * (1 / lens.width + 1 / lens.height)
    return (sx, sy) if abs(sx - sy) < slack else None


def pinhole_shot(
    name: str,
    viewmat: NDArray[np.float64],
    K: NDArray[np.float64],
    image: NDArray[np.uint8],
    distortion: Distortion = PINHOLE,
    mask: NDArray[np.float32] | None = None,
    downscale: int = 1,
) -> Shot:
    """The shot of `image` [H, W, 3], of which counts where `mask` [H, W] is 1."""
    if not distortion.none:
        image, covered = undistort(image, K, distortion)
        if mask is not None:  # only what is made of pixels that count alone
            import cv2

            white = cv2.erode((255 * mask).astype(np.uint8), np.ones((2 * REACH + 1,) * 2))
            kept, _ = undistort(np.repeat(white[..., None], 3, axis=2), K, distortion)
            whole = (kept[..., 0] == 255).astype(np.float32)
            covered = whole if covered is None else covered * whole
        shot = Shot(name, viewmat, K, image, mask=covered, lens=distortion.terms)
        return downscaled(shot, downscale, share=1.0)
    return downscaled(Shot(name, viewmat, K, image, mask=mask), downscale)


def photo_shot(
    file: Path,
    name: str,
    lens: Lens,
    viewmat: NDArray[np.float64],
    downscale: int = 1,
    mask: Path | None = None,
    paper: int | None = None,
    sized: bool = True,
) -> Shot:
    """Read a photo with its camera, undistort and reduce it.

    Args:
        file: the photo.
        name: of the view.
        lens: its camera.
        viewmat: [4, 4] world-to-camera.
        downscale: `scene.downscale`.
        mask: a picture, black where the photo does not count.
        paper: grey value that a transparent photo is laid on; None: what is transparent does not
            count.
        sized: see `reading`.

    Raises:
        UserError: a file is damaged or has other proportions.
    """
    how = reading(file, lens, downscale, sized)
    image, valid, clear = read_masked(file, mask, how.factor, how.turn, paper)
    rest = downscale // how.factor
    shot = pinhole_shot(name, viewmat, how.K, image, lens.distortion, valid, rest)
    return replace(shot, exif=how.exif, clear=clear and paper is not None)


def downscaled(shot: Shot, factor: int, share: float = 0.5) -> Shot:
    """Box means over factor x factor pixels; a last, incomplete row or column is cut. A pixel's
    mask is 1 where at least `share` of what it covers is valid."""
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
