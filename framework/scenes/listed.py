"""Finds the photos that a pose file lists."""

import logging
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath

from framework.errors import require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.scenes.formats import SUFFIXES, find_photo, listed

log = logging.getLogger(__name__)


def match_photos(folder: Path, names: Sequence[str]) -> dict[int, Path]:
    """Find the photos that a pose file lists, see `find_photo`.

    A converted photo counts: `a.jpg` or `A.PNG` for a listed `a.png` that is missing, if it is the
    only image of that stem and no other photo of the list.

    Returns:
        The file of each photo that exists, by its index in the list.
    """
    paths = [find_photo(folder, name) for name in names]
    exact = {i: file for i, file in enumerate(paths) if is_file(file)}
    missing = {i: file for i, file in enumerate(paths) if i not in exact}
    images = _by_stem({file.parent for file in missing.values()}, {*exact.values()})
    stems = Counter(map(_stem, missing.values()))
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


def find_photos(folder: Path, names: Sequence[str], where: str) -> dict[int, Path]:
    """`match_photos`, with a warning about missing and converted photos.

    Raises:
        UserError: no photo exists.
    """
    files = match_photos(folder, names)
    missing = [PurePosixPath(name).name for i, name in enumerate(names) if i not in files]
    require(
        len(files) > 0,
        f"{where}: expected {len(names)} photos, but all are missing ({listed(missing)}); restore"
        " them or choose another folder of photos",
    )
    if missing:
        log.warning(
            f"{where}: {len(missing)} of {len(names)} photos are missing and left out"
            f" ({listed(missing)}); restore them, or remove them from the list"
        )
    pairs = [(file.name, PurePosixPath(names[i]).name) for i, file in files.items()]
    converted = [f"{file} for {name}" for file, name in pairs if file != name]
    if converted:
        log.warning(
            f"{where}: {len(converted)} photos have another name than listed"
            f" ({listed(converted)}); make sure that they are the same photos"
        )
    return files


def warn_unplaced(photos: Path, placed: Iterable[Path]) -> None:
    """Log a warning about images next to the placed photos that have no pose in the model."""
    files = {*placed}
    others = {file for folder in {f.parent for f in files} for file in folder.iterdir()} - files
    names = sorted(file.name for file in others if file.suffix.lower() in SUFFIXES)
    names = [name for name in names if not name.startswith(".")]
    if names:
        log.warning(
            f"{photos}: {len(names)} of {len(names) + len(files)} photos have no pose in the COLMAP"
            f" model and are left out ({listed(names)}); scene=photos finds poses itself"
        )
