"""What `scene.path` holds: a folder of photos or a video, and the name that its content gives.

Photos count by their bytes: renamed, added or edited ones give another key, a new date does not.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from framework.errors import UserError, require
from framework.files.limits import IMAGE_BYTES
from framework.files.opened import open_regular
from framework.files.paths import inside
from framework.scenes.images import SUFFIXES

VERSION = 2  # of the settings and of what is kept; another one finds the poses anew
HEIC = {".heic", ".heif"}
VIDEO = {".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"}
OTHERS = {".tif", ".tiff", ".webp", ".bmp", ".gif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw"}
VIDEO_BYTES = 2**40  # it is read frame by frame
FEWEST = 3  # photos with a place: two to train and one to test
MOST = 2000


@dataclass(frozen=True)
class Source:
    """Distinct photos, or one video. title: what the scene is called. beside: the folder in which
    the poses are kept. copies: photo -> the earlier one with the same bytes, or the JPEG that a
    phone's HEIC photo was also stored as."""

    title: str
    beside: Path
    files: tuple[Path, ...]
    video: bool
    key: str
    side: int
    frames: int
    copies: dict[str, str] = field(default_factory=dict)


def find_source(path: str, side: int, frames: int) -> Source:
    """Raises UserError where there are no photos, too few, or only one many times."""
    place = Path(path).expanduser()
    if place.is_file():
        return _video(place, side, frames)
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
    _check_count(place, len(files), len(distinct))
    key = _key([side, *((file.name, hashes[file]) for file in distinct)])
    return Source(place.resolve().name, folder, distinct, False, key, side, frames, copies)


def _twins(files: Sequence[Path]) -> dict[str, str]:
    """Names of HEIC photos -> those of the JPEGs beside them that are called the same."""
    jpegs = {f.stem.lower(): f.name for f in files if f.suffix.lower() in (".jpg", ".jpeg")}
    heic = [f for f in files if f.suffix.lower() in HEIC]
    return {f.name: jpegs[f.stem.lower()] for f in heic if f.stem.lower() in jpegs}


def _video(file: Path, side: int, frames: int) -> Source:
    require(
        file.suffix.lower() in VIDEO,
        f"{file}: expected a folder of photos or a video ({', '.join(sorted(VIDEO))}), got another"
        " file; correct scene.path",
    )
    key = _key([side, frames, _sha256(file, VIDEO_BYTES)])
    return Source(file.resolve().stem, file.parent, (file,), True, key, side, frames)


def _photos(folder: Path) -> list[Path]:
    """Sorted by name, hidden files left out. Raises UserError for one that leads elsewhere."""
    kinds = SUFFIXES | HEIC
    found = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in kinds)
    return [inside(folder, name) for name in found if not name.startswith(".")]


def _instead(folder: Path) -> str:
    """What is there instead of photos, and what to do."""
    names = sorted(p.name for p in folder.iterdir())
    videos = [name for name in names if Path(name).suffix.lower() in VIDEO]
    if videos:
        return f"a video; give it itself, scene.path={folder / videos[0]}"
    others = [name for name in names if Path(name).suffix.lower() in OTHERS]
    if others:
        return f"{len(others)} pictures of other kinds (first: {others[0]}); convert them to JPEG"
    folders = [name for name in names if not name.startswith(".") and (folder / name).is_dir()]
    got = f"only folders ({', '.join(folders[:5])})" if folders else "none"
    return f"{got}; put photos there or correct scene.path"


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


def _sha256(file: Path, limit: int = IMAGE_BYTES) -> str:
    with open_regular(file, limit) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _key(parts: Sequence[object]) -> str:
    return hashlib.sha256(repr([VERSION, *parts]).encode("utf-8", "surrogatepass")).hexdigest()[:16]
