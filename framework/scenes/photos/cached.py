"""The kept poses of a source: found once, then read.

They are made in a folder beside, under its lock, and renamed into place when they are complete:
whole or not at all, whoever is killed, and two processes that want the same do the work once.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from framework.files.cache import cache_dir
from framework.files.locks import Busy, locked
from framework.scenes.photos.child import run_child
from framework.scenes.photos.found import FILE
from framework.scenes.photos.source import Source

PREFIX = "fishersplat-poses-"

log = logging.getLogger(__name__)


def poses_folder(source: Source) -> Path:
    """The folder in the user's cache with `sparse/0`, `images` and `poses.json` of the source.
    Raises UserError where too few photos find a place."""
    folder = cache_dir() / "poses" / f"{PREFIX}{source.key}"
    return folder if _complete(folder) else _made(folder, source)


def _complete(folder: Path) -> bool:
    return (folder / FILE).is_file() and all((folder / n).is_dir() for n in ("images", "sparse"))


def _made(folder: Path, source: Source) -> Path:
    """`folder`, by this process or by another that is at it."""
    work = folder.with_name(f".{folder.name}.work")  # stays: others may be waiting for its lock
    with _alone(work):
        if not _complete(folder):
            _make(folder, work / "made", source)
    return folder


@contextlib.contextmanager
def _alone(work: Path) -> Iterator[None]:
    """Hold the lock of `work`, waiting for it if need be."""
    with contextlib.ExitStack() as lock:
        try:
            lock.enter_context(locked(work))
        except Busy as busy:
            log.info("scene=photos: waiting for another process to find the poses: %s", busy)
            lock.enter_context(locked(work, wait=True))
        yield


def _make(folder: Path, made: Path, source: Source) -> None:
    """Make the content in `made` and rename it to `folder`."""
    shutil.rmtree(made, ignore_errors=True)  # of a killed process
    try:
        made.mkdir()
        run_child(source, made)
        _on_disk(made)
        if folder.exists():  # something is missing in it
            shutil.rmtree(folder)
        os.rename(made, folder)
    finally:
        shutil.rmtree(made, ignore_errors=True)


def _on_disk(folder: Path) -> None:
    """All files' content is on the disk before the rename, so that a power failure cannot leave
    empty ones under the final name."""
    for path in folder.rglob("*"):
        if path.is_file():
            with path.open("rb") as file:
                os.fsync(file.fileno())
