"""One process at a time in a folder: an advisory lock (`flock`) on its file `.lock`.

The system drops the lock when its process ends, however it ends, so there are no stale locks to
judge; the file that a killed process leaves is simply locked anew, and `remove_stale` takes it
away where nobody will. It tells who holds it.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from framework.errors import UserError, mendable
from framework.files.whole import Unwritable, unwritable

LOCK = ".lock"


class Busy(UserError):
    """Another process holds the lock."""


@contextmanager
def locked(folder: Path, wait: bool = False) -> Iterator[None]:
    """Hold the lock of `folder`, which is made if missing. Raises Busy at once when another
    process has it, unless `wait`; Unwritable where the folder cannot be written."""
    file = _taken(folder / LOCK, wait)
    try:
        _sign(file)
        yield
    finally:
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink()  # while it is still ours
        file.close()


def remove_stale(folder: Path) -> None:
    """Remove the lock file in `folder` of a process that was killed when its work was done."""
    if (folder / LOCK).exists():
        with contextlib.suppress(UserError), locked(folder):
            pass


def _sign(file: IO[str]) -> None:
    """Tell others who holds the lock; where the disk is full they will not know."""
    owner = {"pid": os.getpid(), "host": platform.node(), "since": time.strftime("%F %T")}
    with contextlib.suppress(OSError):
        os.ftruncate(file.fileno(), 0)
        os.write(file.fileno(), json.dumps(owner).encode())


def _taken(path: Path, wait: bool) -> IO[str]:
    """The opened and locked lock file."""
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("a+", encoding="utf-8")
        except OSError as error:
            if not mendable(error):
                raise
            raise Unwritable(unwritable(error, path)) from error
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            file.seek(0)
            owner = _owner(file.read())
            file.close()
            raise Busy(
                f"{path.parent}: expected nobody else at this run, got {owner};"
                " wait for it, or stop it"
            ) from error
        if _is_same(file, path):
            return file
        file.close()  # its owner removed it between our opening and locking it


def _is_same(file: IO[str], path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except FileNotFoundError:
        return False


def _owner(text: str) -> str:
    try:
        told = json.loads(text)
        return f"process {told['pid']} on {told['host']} since {told['since']}"
    except (ValueError, KeyError, TypeError):  # it is just being written
        return "another process"
