"""Keeps the user's cache small.

Folders of killed commands are removed by the next command. Files that can be generated again are
removed if they were not used for long: compiled kernels, one folder for each version of the code,
and pictures of the embedded scene. Poses of photos and weights stay.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from framework.errors import UserError
from framework.files.cache import cache_dir, usable
from framework.files.locks import LOCK, locked

UNUSED_DAYS = 90
UNSIGNED_DAYS = 7  # a folder without a lock may be in use by another version
YOUNG_S = 3600.0  # a younger one may not be locked yet
REMADE = ("kernels/*", "embedded-*.npz")
DAILY = ".tidied"  # modified at the last removal of unused files
DAY_S = 86400.0


@contextmanager
def own_folder(prefix: str) -> Iterator[Path]:
    """A temporary folder of this process in the cache.

    It is removed at the end, or by a call an hour later if the process is killed.

    Raises:
        Unwritable: if it cannot be made.
    """
    parent = cache_dir()
    tidy(prefix)
    with usable(parent):
        temporary = tempfile.TemporaryDirectory(
            prefix=prefix, dir=parent, ignore_cleanup_errors=True
        )
    with temporary as name, locked(Path(name)):
        yield Path(name)


def tidy(prefix: str) -> None:
    """Remove folders of ended processes that begin with `prefix` and, once a day, what was not used
    for UNUSED_DAYS. Ignores what cannot be removed."""
    with contextlib.suppress(OSError):
        for folder in cache_dir().glob(f"{prefix}*"):
            if _is_abandoned(folder):
                shutil.rmtree(folder, ignore_errors=True)
        _remove_unused(cache_dir())


def _is_abandoned(folder: Path) -> bool:
    """Whether the process that made the folder has ended."""
    try:
        age_s = time.time() - folder.stat().st_mtime
        if age_s < YOUNG_S or not (folder / LOCK).exists():
            return age_s > UNSIGNED_DAYS * DAY_S
        with locked(folder):
            return True
    except (OSError, UserError):  # locked, or being removed
        return False


def _remove_unused(cache: Path) -> None:
    stamp, now = cache / DAILY, time.time()
    if stamp.exists() and abs(now - stamp.stat().st_mtime) < DAY_S:
        return
    stamp.touch()
    for pattern in REMADE:
        for path in cache.glob(pattern):
            if now - _last_used(path) > UNUSED_DAYS * DAY_S:
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink(missing_ok=True)


def _last_used(path: Path) -> float:
    """When the file, or the latest one in the folder, was read or written; without access times,
    when it was written."""
    every = [path, *path.rglob("*")]
    times = [path.stat() for path in every if not path.is_dir()] or [path.stat()]
    return max(max(status.st_atime, status.st_mtime) for status in times)
