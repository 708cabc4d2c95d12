"""Image files of a scene: listing and reading. Pixels are 8-bit RGB as stored, EXIF turns ignored
(structure from motion ignores them too, so the poses belong to the stored pixels).
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SUFFIXES = {".png", ".jpg", ".jpeg"}
EIGHT_BIT = {"L", "P", "RGB", "RGBA", "LA"}


def scene_folder(loader: str, path: str) -> Path:
    """The scene's folder. Raises UserError if it is none."""
    folder = Path(path).expanduser()
    require(
        folder.is_dir(),
        f"scene={loader}: expected a folder at '{path}', found"
        f" {'a file' if folder.exists() else 'nothing'}; correct scene.path",
    )
    return folder


def list_images(folder: Path) -> list[Path]:
    """The image files of `folder`, sorted by name. Raises UserError if there are none."""
    found = sorted(folder.glob("*")) if folder.is_dir() else []
    images = [p for p in found if p.suffix.lower() in SUFFIXES and not p.name.startswith(".")]
    if not images:
        what = "no image in it" if folder.is_dir() else "no such folder"
        raise UserError(
            f"{folder}: expected a folder of {', '.join(sorted(SUFFIXES))} images, got {what};"
            " put the images there or choose another folder"
        )
    return images


def read_image(path: Path) -> NDArray[np.uint8]:
    """[H, W, 3] uint8. Raises UserError for a damaged, deeper than 8-bit or transparent image."""
    import numpy as np
    from PIL import Image

    try:
        with Image.open(path) as image:
            image.load()
            mode = image.mode
            transparent = "A" in mode and image.getchannel("A").getextrema()[0] != 255
            pixels = np.asarray(image.convert("RGB"), dtype=np.uint8)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        reason = " ".join(str(error).split()).replace(str(path), "").strip(" '")
        raise UserError(
            f"{path}: expected a readable image, got a damaged file ({reason}); replace it"
        ) from None
    require(mode in EIGHT_BIT, f"{path}: expected 8 bits per channel, got mode {mode}; convert it")
    require(not transparent, f"{path}: expected an opaque image, got transparency; flatten it")
    return pixels


def resize_ratio(model: int, image: int) -> float | None:
    """Factor from camera pixels to image pixels along one axis; None if `image` is neither `model`
    nor `model` times or over an integer (rounded either way, as resizers do)."""
    if model == image:
        return 1.0
    large, small = max(model, image), min(model, image)
    if abs(large / round(large / small) - small) < 1 and round(large / small) > 1:
        return image / model
    return None
