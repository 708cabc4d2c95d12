"""Keeps the user's cache from growing for ever.

What commands leave that were killed goes with the next command. What is made anew when it is needed
(compiled kernels, one folder for each version of the code; pictures of the embedded scene) goes
when nobody has used it for long. Poses of photos and weights stay: they are dear, and few.
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
UNSIGNED_DAYS = 7  # a folder without a lock is another version's, which may be at it
YOUNG_S = 3600.0  # a younger one may have been made, and not yet locked
REMADE = ("kernels/*", "embedded-*.npz")
DAILY = ".tidied"  # its time is that of the last look at what is unused
DAY_S = 86400.0


@contextmanager
def own_folder(prefix: str) -> Iterator[Path]:
    """An empty folder of this process in the cache, removed at the end or, if the process is killed
    before, with another call an hour later. Raises Unwritable where none can be made."""
    parent = cache_dir()
    tidy(prefix)
    with usable(parent):
        made = tempfile.TemporaryDirectory(prefix=prefix, dir=parent, ignore_cleanup_errors=True)
    with made as name, locked(Path(name)):
        yield Path(name)


def tidy(prefix: str) -> None:
    """Remove the folders that begin with `prefix` and whose owners are gone and, once a day, what
    nobody has used for UNUSED_DAYS. What cannot be removed stays."""
    with contextlib.suppress(OSError):
        for folder in cache_dir().glob(f"{prefix}*"):
            if _left(folder):
                shutil.rmtree(folder, ignore_errors=True)
        _remove_unused(cache_dir())


def _left(folder: Path) -> bool:
    """Whether the process that made the folder is gone."""
    try:
        age_s = time.time() - folder.stat().st_mtime
        if age_s < YOUNG_S or not (folder / LOCK).exists():
            return age_s > UNSIGNED_DAYS * DAY_S
        with locked(folder):
            return True
    except (OSError, UserError):  # somebody is at it, or it is just being removed
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
    """When the file, or the last one in the folder, was read or written; where the file system
    keeps no times of reading, when it was made."""
    every = [path, *path.rglob("*")]
    times = [path.stat() for path in every if not path.is_dir()] or [path.stat()]
    return max(max(told.st_atime, told.st_mtime) for told in times)
