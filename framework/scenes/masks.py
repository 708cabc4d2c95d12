"""Masks in `masks/`: black where a photo does not count.

The mask of `images/sub/a.jpg` is `masks/sub/a.jpg.png` (COLMAP) or `masks/sub/a.png` (nerfstudio).
Reduced photos (`images_8/`) use `masks_8/` if it exists. A mask of another size is resized.
"""

import logging
import os
from collections.abc import Sequence
from pathlib import Path

from framework.files.paths import inside
from framework.scenes.formats import SUFFIXES, listed

log = logging.getLogger(__name__)

FOLDER = "masks"


def find_masks(folder: Path, photos: str, names: Sequence[str]) -> list[Path | None]:
    """Find the mask of each photo; log a warning about photos without one.

    Args:
        folder: the scene.
        photos: name of the folder of photos, such as `images_8`; "" for none.
        names: paths of the photos inside it.

    Returns:
        A mask per photo, None where there is none. All None if there is no folder of masks.

    Raises:
        UserError: a mask is a link that leads out of the folder.
    """
    places = [photos.replace("images", FOLDER, 1), FOLDER]
    places = [p for p in places if p not in ("", photos) and (folder / p).is_dir()]
    root = inside(folder, places[0]) if places else None
    files = _images(root) if root else {}
    if root is None or not files:
        return [None] * len(names)
    masks = [_mask(root, files, name) for name in names]
    bare = [name for name, mask in zip(names, masks, strict=True) if mask is None]
    if bare:
        log.warning(
            f"{root}: {len(bare)} of {len(names)} photos have no mask and count as a whole"
            f" ({listed(bare)}); a photo's mask is NAME.png or NAME.jpg.png"
        )
    return masks


def _images(root: Path) -> dict[str, str]:
    """Path inside the folder by its lower-case form."""
    files = (path for path in sorted(root.rglob("*")) if path.suffix.lower() in SUFFIXES)
    paths = [file.relative_to(root).as_posix() for file in files]
    return {path.lower(): path for path in paths}


def _mask(root: Path, files: dict[str, str], name: str) -> Path | None:
    bare = os.path.splitext(name)[0]
    candidates = (f"{name}.png", *(f"{bare}{suffix}" for suffix in (".png", ".jpg", ".jpeg")))
    for candidate in candidates:
        if candidate.lower() in files:
            return inside(root, files[candidate.lower()])
    return None
