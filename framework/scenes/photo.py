"""From a stored photo and its camera to a `Shot`: undistorted, then box-downscaled.

Photos are read one at a time and reduced at once, so a scene never needs much more memory than its
reduced views; what those need is checked from the file headers before the first photo is decoded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.errors import UserError, require
from framework.files.limits import SCENE_BYTES
from framework.scenes.assemble import Shot, intrinsics
from framework.scenes.images import image_size, read_masked, resize_ratio
from framework.scenes.lens import PINHOLE, Distortion, Lens, undistort

if TYPE_CHECKING:
    from numpy.typing import NDArray

BYTES_PER_PIXEL = 12  # three float32
REACH = 6  # pixels from which taking a lens out mixes a pixel: half of 8, and what overshoots
MOST_STRETCH = 1.1  # by which the two axes of a resized photo may differ


def check_memory(files: Sequence[Path], downscale: int) -> None:
    """Raise UserError if the downscaled images would take more than 4 GiB."""
    pixels = 0
    for file in files:
        width, height = image_size(file)
        pixels += (width // downscale) * (height // downscale)
    need = pixels * BYTES_PER_PIXEL
    require(
        need <= SCENE_BYTES,
        f"{files[0].parent}: expected images of at most {SCENE_BYTES >> 30} GiB in all, got"
        f" {need / 2**30:.1f} GiB ({len(files)} views); raise scene.downscale (now {downscale})",
    )


def resized(file: Path, image: NDArray[np.uint8], lens: Lens) -> NDArray[np.float64]:
    """[3, 3] K of `lens` for `image`, which may be the lens' size or that times or over an integer.

    Raises UserError for any other size.
    """
    height, width = image.shape[:2]
    sx, sy = resize_ratio(lens.width, width), resize_ratio(lens.height, height)
    if sx is None or sy is None or max(sx, sy) > MOST_STRETCH * min(sx, sy):
        raise UserError(
            f"{file}: expected the camera's {lens.width}x{lens.height} pixels or that times or over"
            f" an integer, got {width}x{height}; resize the images or choose another scene.images"
        )
    return intrinsics(lens.fx * sx, lens.fy * sy, lens.cx * sx, lens.cy * sy)


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
        shot = Shot(name, viewmat, K, image, mask=covered, lens=astuple(distortion))
        return downscaled(shot, downscale, share=1.0)
    return downscaled(Shot(name, viewmat, K, image, mask=mask), downscale)


def photo_shot(
    file: Path,
    name: str,
    lens: Lens,
    viewmat: NDArray[np.float64],
    downscale: int = 1,
    mask: Path | None = None,
) -> Shot:
    """Read a photo; what is transparent, or black in `mask`, does not count.

    Raises:
        UserError: a file is damaged or has another size.
    """
    image, valid = read_masked(file, mask)
    K = resized(file, image, lens)
    return pinhole_shot(name, viewmat, K, image, lens.distortion, valid, downscale)


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
