"""One process at a time in a folder: a lock on its file `.lock`; `.lock.holder` names the holder.

The system releases the lock when its process ends, also by a crash. On file systems without such
locks (some network ones), filelock falls back to a file that only one process can create. It then
checks whether the process that created it on this machine is still alive.
"""

from __future__ import annotations

import contextlib
import os
import platform
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from framework.errors import UserError, mendable, os_line
from framework.files.opened import read_text
from framework.files.whole import Unwritable, write_whole

LOCK, HOLDER = ".lock", ".lock.holder"
HOLDER_BYTES = 4096


class Busy(UserError):
    """Another process holds the lock."""


@contextmanager
def locked(folder: Path, wait: bool = False) -> Iterator[None]:
    """Hold the lock of `folder`, which is made if missing.

    Raises:
        Busy: another process holds it, unless `wait`.
        Unwritable: the folder cannot be written, or its lock is a link.
    """
    lock = FileLock(folder / LOCK, timeout=-1 if wait else 0)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise Busy(
            f"{folder}: expected no other process at this run, got {_holder(folder)}; wait for it"
        ) from None
    except OSError as error:
        if not mendable(error):
            raise
        raise Unwritable(os_line(error, folder / LOCK)) from error
    try:
        _sign(folder)
        yield
    finally:
        for name in (HOLDER, LOCK):  # while the lock is still ours
            with contextlib.suppress(OSError):
                (folder / name).unlink()
        lock.release()


def remove_stale(folder: Path, also: Callable[[Path], None]) -> None:
    """Remove the lock file of a process that was killed when its work was done, and what `also`
    removes; nothing while a process is at work in `folder`."""
    if (folder / LOCK).exists():
        with contextlib.suppress(UserError), locked(folder):
            also(folder)


def _sign(folder: Path) -> None:
    """Write the lock's holder, for messages; errors do not matter."""
    holder = f"process {os.getpid()} on {platform.node()} since {time.strftime('%F %T')}"
    with contextlib.suppress(UserError, OSError):
        write_whole(folder / HOLDER, holder)


def _holder(folder: Path) -> str:
    try:
        return read_text(folder / HOLDER, HOLDER_BYTES)[:200] or "another process"
    except (UserError, OSError):  # it is just being written
        return "another process"
