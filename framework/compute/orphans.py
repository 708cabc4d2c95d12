"""A process that a command started ends soon after the command is gone.

Without this a killed study leaves a launcher's workers: they finish their runs, then wait for more,
half a gigabyte each. What they were training is kept in checkpoints, as after any kill.
"""

from __future__ import annotations

import os
import threading
import time
from multiprocessing import parent_process

POLL_S = 0.25

_watching = False
_others: set[int] = set()  # whom this process ends with


def end_with_parent() -> None:
    """Watch the parent from now on, if this process is a launcher's worker; else do nothing."""
    global _watching
    parent = parent_process()
    if _watching or parent is None:
        return
    _watching = True
    watch(parent.pid)


def watch(parent: int | None) -> None:
    """End this process soon after the one with the number `parent`, which started it."""
    threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def end_with(process: int) -> None:
    """End this process soon after another one of this machine that is not its parent. A worker
    calls it for every run; one thread watches each process.
    """
    if process in _others:
        return
    _others.add(process)
    threading.Thread(target=_watch_other, args=(process,), daemon=True).start()


def _watch_other(process: int) -> None:
    while True:
        try:
            os.kill(process, 0)
        except ProcessLookupError:
            os._exit(1)
        except PermissionError:
            pass
        time.sleep(POLL_S)


def _watch(parent: int | None) -> None:
    """A process whose parent has ended gets another one, perhaps before it came to this line."""
    while os.getppid() == parent:
        time.sleep(POLL_S)
    os._exit(1)  # no clean-up: it would wait for the parent's queues
