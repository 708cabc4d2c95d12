"""Photos that a pose file lists, and those of them that the scene's folder holds."""

from __future__ import annotations

import logging
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from framework.errors import require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.formats import SUFFIXES, listed

log = logging.getLogger(__name__)


def match_photos(paths: Sequence[Path]) -> dict[int, Path]:
    """Find the listed photos.

    A converted photo counts: `a.jpg` or `A.PNG` for a listed `a.png` that is missing, if it is the
    only image of that stem and no other photo of the list.

    Returns:
        The file of each photo that exists, by its index in the list.

    Raises:
        UserError: a converted photo is a link that leads out of its folder.
    """
    exact = {i: file for i, file in enumerate(paths) if is_file(file)}
    missing = {i: file for i, file in enumerate(paths) if i not in exact}
    images = _by_stem({file.parent for file in missing.values()}, {*exact.values()})
    stems = Counter(_stem(file) for file in missing.values())
    converted = {
        i: inside(file.parent, images[stem][0].name)
        for i, file in missing.items()
        if stems[stem := _stem(file)] == 1 and len(images[stem]) == 1
    }
    return dict(sorted({**exact, **converted}.items()))


def _stem(file: Path) -> str:
    return f"{file.parent}/{file.stem.lower()}"


def _by_stem(folders: Iterable[Path], taken: set[Path]) -> dict[str, list[Path]]:
    images: dict[str, list[Path]] = defaultdict(list)
    for file in (file for folder in folders if folder.is_dir() for file in folder.iterdir()):
        if file.suffix.lower() in SUFFIXES and file not in taken and is_file(file):
            images[_stem(file)].append(file)
    return images


def find_photos(paths: Sequence[Path], where: str) -> dict[int, Path]:
    """Find the listed photos; log a warning about missing and converted ones.

    Returns:
        The file of each photo that exists, by its index in the list.

    Raises:
        UserError: none exists.
    """
    found = match_photos(paths)
    missing = [file.name for i, file in enumerate(paths) if i not in found]
    require(
        len(found) > 0,
        f"{where}: expected {len(paths)} photos, but all are missing ({listed(missing)}); restore"
        " them or choose another folder of photos",
    )
    if missing:
        log.warning(
            f"{where}: {len(missing)} of {len(paths)} photos are missing and left out"
            f" ({listed(missing)}); restore them, or remove them from the list"
        )
    converted = [f"{f.name} for {paths[i].name}" for i, f in found.items() if f != paths[i]]
    if converted:
        log.warning(
            f"{where}: {len(converted)} photos have another name than listed"
            f" ({listed(converted)}); make sure that they are the same photos"
        )
    return found


def warn_unplaced(photos: Path, placed: Iterable[Path]) -> None:
    """Log a warning about images beside the placed photos that the model has no pose for."""
    files = {*placed}
    others = {file for folder in {f.parent for f in files} for file in folder.iterdir()} - files
    names = sorted(file.name for file in others if file.suffix.lower() in SUFFIXES)
    names = [name for name in names if not name.startswith(".")]
    if names:
        log.warning(
            f"{photos}: {len(names)} of {len(names) + len(files)} photos have no pose in the COLMAP"
            f" model and are left out ({listed(names)}); scene=photos finds poses itself"
        )
