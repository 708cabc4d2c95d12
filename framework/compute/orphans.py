"""A process that a command started ends soon after the command is gone.

Without this a killed study leaves a launcher's workers: they finish their runs, then wait for more,
half a gigabyte each. What they were training is kept in checkpoints, as after any kill.
"""

import os
import threading
import time
from collections.abc import Callable
from multiprocessing import parent_process

POLL_S = 0.25

_ends_with: set[int] = set()  # processes that this one ends with


def end_with_parent() -> None:
    """Watch the parent from now on, if this process is a launcher's worker; else do nothing."""
    parent = parent_process()
    if parent is not None and parent.pid is not None:
        watch(parent.pid)


def watch(parent: int) -> None:
    """End this process soon after the one with the number `parent`, which started it."""
    # a process whose parent has ended gets another one, perhaps before it came to this line
    _watch(parent, lambda: os.getppid() == parent)


def end_with(process: int) -> None:
    """End this process soon after another one of this machine that is not its parent."""
    _watch(process, lambda: _exists(process))


def _exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _watch(process: int, lives: Callable[[], bool]) -> None:
    """One thread watches each process, however often a worker asks."""

    def wait() -> None:
        while lives():
            time.sleep(POLL_S)
        os._exit(1)  # no clean-up: it would wait for the parent's queues

    if process not in _ends_with:
        _ends_with.add(process)
        threading.Thread(target=wait, daemon=True).start()
