"""What `scene.path` holds, a folder of photos or a video, and a key from its content.

The key depends on the photos' names and bytes, not on their dates.
"""

import hashlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from framework.errors import UserError, require
from framework.files.limits import PHOTO_BYTES
from framework.files.opened import open_regular
from framework.files.paths import inside
from framework.scenes.formats import (
    HEIC,
    SUFFIXES,
    UNREAD,
    VIDEO,
    is_photo,
    listed,
    unread_files,
    warn_left_out,
)
from framework.scenes.photos.options import SIFT

log = logging.getLogger(__name__)

VERSION = 2  # of the settings and of the result; another one searches again
VIDEO_BYTES = 2**40  # videos are read frame by frame
FEWEST = 3  # placed photos: two to train and one to test
MOST = 2000


@dataclass(frozen=True)
class Source:
    """Distinct photos, or one video.

    Attributes:
        title: name of the scene.
        copies: photo -> the earlier one with the same bytes, or the JPEG version of a HEIC photo.
    """

    title: str
    folder: Path
    files: tuple[Path, ...]
    video: bool
    key: str
    side: int
    frames: int
    matching: str = SIFT
    copies: dict[str, str] = field(default_factory=dict)


def find_source(path: str, side: int, frames: int, matching: str = SIFT) -> Source:
    """Find the photos or the video.

    Raises:
        UserError: for too few different photos.
    """
    place = Path(path).expanduser()
    if place.is_file():
        return _video(place, side, frames, matching)
    require(
        place.is_dir(),
        f"scene=photos: expected a folder of photos or a video at '{path}', found nothing; correct"
        " scene.path",
    )
    folder = place
    if not _photos(place) and (place / "images").is_dir():
        folder = inside(place, "images")
    files = _photos(folder)
    if not files:
        raise UserError(
            f"{place}: expected photos ({', '.join(sorted(SUFFIXES | HEIC))}), got"
            f" {_instead(folder)}"
        )
    twins = _twins(files)
    hashes = {file: _sha256(file) for file in files if file.name not in twins}
    first: dict[str, Path] = {}
    for file, sha in hashes.items():
        first.setdefault(sha, file)
    copies = {f.name: first[sha].name for f, sha in hashes.items() if first[sha] != f} | twins
    distinct = tuple(first.values())
    _warn_left_out(folder)
    _check_count(place, len(files), len(distinct))
    key = _key(matching, [side, *((file.name, hashes[file]) for file in distinct)])
    name = place.resolve().name
    return Source(name, folder, distinct, False, key, side, frames, matching, copies)


def _twins(files: Sequence[Path]) -> dict[str, str]:
    """Names of HEIC photos -> those of the JPEGs with the same stem."""
    jpegs = {f.stem.lower(): f.name for f in files if f.suffix.lower() in (".jpg", ".jpeg")}
    heic = [f for f in files if f.suffix.lower() in HEIC]
    return {f.name: jpegs[f.stem.lower()] for f in heic if f.stem.lower() in jpegs}


def _video(file: Path, side: int, frames: int, matching: str) -> Source:
    require(
        file.suffix.lower() in VIDEO,
        f"{file}: expected a folder of photos or a video ({', '.join(sorted(VIDEO))}), got another"
        " file; correct scene.path",
    )
    key = _key(matching, [side, frames, _sha256(file, VIDEO_BYTES)])
    return Source(file.resolve().stem, file.parent, (file,), True, key, side, frames, matching)


def _photos(folder: Path) -> list[Path]:
    """The photos, sorted by name, without hidden ones."""
    return [inside(folder, p.name) for p in sorted(folder.iterdir()) if is_photo(p)]


def _warn_left_out(folder: Path) -> None:
    """Log warnings about files that are not read, and about photos in sub-folders."""
    warn_left_out(f"scene=photos: {folder}", unread_files(folder, UNREAD | VIDEO))
    folders = [p for p in sorted(folder.iterdir()) if p.is_dir() and not p.name.startswith(".")]
    nested = [p.name for p in folders if any(map(is_photo, p.iterdir()))]
    if nested:
        log.warning(
            f"scene=photos: {folder}: photos in its folders are left out ({listed(nested)}); move"
            " all photos into one folder"
        )


def _instead(folder: Path) -> str:
    """The end of a message about a folder without photos."""
    names = sorted(p.name for p in folder.iterdir())
    videos = [name for name in names if Path(name).suffix.lower() in VIDEO]
    if videos:
        return f"a video; use scene.path={folder / videos[0]}"
    others = unread_files(folder)
    if others:
        return f"{len(others)} pictures in other formats ({listed(others)}); convert them to JPEG"
    return f"none ({listed(names) or 'empty'}); put photos there or correct scene.path"


def _check_count(place: Path, n_files: int, n_distinct: int) -> None:
    require(
        n_distinct > 1 or n_files == 1,
        f"{place}: expected photos from different places, got the same photo {n_files} times; take"
        " some from other places",
    )
    require(
        n_distinct >= FEWEST,
        f"{place}: expected at least {FEWEST} different photos, got {n_distinct}; take more, a step"
        " to the side between one and the next",
    )
    require(
        n_distinct <= MOST,
        f"{place}: expected at most {MOST} photos, got {n_distinct}; move some elsewhere",
    )


def _sha256(file: Path, limit: int = PHOTO_BYTES) -> str:
    with open_regular(file, limit) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _key(matching: str, parts: Sequence[object]) -> str:
    learned = [] if matching == SIFT else [matching]
    return hashlib.sha256(
        repr([VERSION, *learned, *parts]).encode("utf-8", "surrogatepass")
    ).hexdigest()[:16]
