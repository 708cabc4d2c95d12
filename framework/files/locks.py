"""One process at a time in a folder: an advisory lock (`flock`) on its file `.lock`.

The system drops the lock when its process ends, however it ends, so there are no stale locks to
judge; the file that a killed process leaves is simply locked anew, and `remove_stale` takes it
away where nobody will. It tells who holds it.

Where the file system has no such locks (some network ones), a file `.lock.held` that only one can
create stands for it. It stays when its process is killed: one of this machine is told from a living
one by its number, one of another machine is for the user to judge, in one line.
"""

from __future__ import annotations

import contextlib
import errno
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

LOCK, HELD = ".lock", ".lock.held"
NO_LOCKS = frozenset((errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL))
POLL_S = 0.2  # between looks at a file that stands for a lock


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
        for name in (HELD, LOCK) if file.name.endswith(HELD) else (LOCK,):
            with contextlib.suppress(OSError):
                (folder / name).unlink()  # while it is still ours
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
        except OSError as error:
            file.close()
            if error.errno not in NO_LOCKS:
                raise
            return _held(path.with_name(HELD), wait)
        if _is_same(file, path):
            return file
        file.close()  # its owner removed it between our opening and locking it


def _held(path: Path, wait: bool) -> IO[str]:
    """The file that stands for a lock, created by us."""
    while True:
        try:
            return path.open("x", encoding="utf-8")
        except FileExistsError:
            text = _text(path)
        if text is not None and _dead(text):
            _bury(path, text)
        elif not wait:
            raise Busy(
                f"{path.parent}: expected nobody else at this run, got {_owner(text or '')}, and no"
                f" locks on this file system; wait for it, or remove {path.name} if it is gone"
            )
        else:
            time.sleep(POLL_S)


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:  # just removed
        return None


def _dead(text: str) -> bool:
    """Whether the owner was a process of this machine that is no more."""
    try:
        told = json.loads(text)
        if told["host"] != platform.node():
            return False
        os.kill(int(told["pid"]), 0)
    except ProcessLookupError:
        return True
    except (ValueError, KeyError, TypeError, OverflowError, OSError):
        return False
    return False


def _bury(path: Path, text: str) -> None:
    """Remove the file of a dead owner: renamed first, as only one of several can do, and put back
    if it was another's by then."""
    grave = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    with contextlib.suppress(OSError):
        path.rename(grave)
        if _text(grave) != text:
            os.link(grave, path)
        grave.unlink()


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
