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
import stat
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from framework.errors import UserError, mendable
from framework.files.opened import read_bytes
from framework.files.whole import Unwritable, unwritable

LOCK, HELD = ".lock", ".lock.held"
NO_LOCKS = frozenset((errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL))
NEVER_ELSEWHERE = os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
OWNER_BYTES = 4096  # of the lines that tell who holds a lock
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


def remove_stale(folder: Path, also: Callable[[Path], None]) -> None:
    """Remove the lock file in `folder` of a process that was killed when its work was done, and
    what `also` removes; nothing where a process is at work there."""
    if (folder / LOCK).exists():
        with contextlib.suppress(UserError), locked(folder):
            also(folder)


def _sign(file: IO[str]) -> None:
    """Tell others who holds the lock; where the disk is full they will not know."""
    owner = {"pid": os.getpid(), "host": platform.node(), "since": time.strftime("%F %T")}
    with contextlib.suppress(OSError):
        os.ftruncate(file.fileno(), 0)
        os.write(file.fileno(), json.dumps(owner).encode())


def _taken(path: Path, wait: bool) -> IO[str]:
    """The opened and locked lock file."""
    while True:
        file = _opened(path)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError as error:
            owner = _owner(os.pread(file.fileno(), OWNER_BYTES, 0).decode("utf-8", "replace"))
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


def _opened(path: Path) -> IO[str]:
    """The lock file, made if missing. A link in its place is not followed, for what it leads to
    would be overwritten; a pipe or the like is no lock."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        found = os.open(path, os.O_RDWR | os.O_CREAT | NEVER_ELSEWHERE, 0o666)
    except OSError as error:
        if path.is_symlink() or not mendable(error):
            _no_lock(path)
            raise
        raise Unwritable(unwritable(error, path)) from error
    if not stat.S_ISREG(os.fstat(found).st_mode):
        os.close(found)
        _no_lock(path)
    return open(path, "r+", encoding="utf-8", opener=lambda *_: found)


def _no_lock(path: Path) -> None:
    """Raise Unwritable where `path` is there and no file."""
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise Unwritable(
            f"{path}: expected a file of this program, got a link, a pipe or the like; remove it"
            " and run the same again"
        )


def _held(path: Path, wait: bool) -> IO[str]:
    """The file that stands for a lock, created by us."""
    while True:
        try:
            return path.open("x", encoding="utf-8")
        except FileExistsError:
            _no_lock(path)
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
        return read_bytes(path, OWNER_BYTES).decode("utf-8", "replace")
    except (OSError, UserError):  # just removed
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
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError, OSError):
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
    except (ValueError, KeyError, TypeError, RecursionError):  # it is just being written
        return "another process"
