"""Wall-clock and CPU seconds of a work that pauses, or that another process began."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

from framework.compute.parallel import in_task


class Stopwatch:
    """Runs from its creation.

    CPU time is that of the whole process, all threads together; that of its thread in a task, which
    has just the one.

    Args:
        wall_s, cpu_s: seconds already counted before, in another process.
    """

    def __init__(self, wall_s: float = 0.0, cpu_s: float = 0.0) -> None:
        self._cpu_time = time.thread_time if in_task() else time.process_time
        self._wall, self._cpu = time.perf_counter() - wall_s, self._cpu_time() - cpu_s

    @property
    def wall_s(self) -> float:
        """Seconds counted so far."""
        return time.perf_counter() - self._wall

    @property
    def cpu_s(self) -> float:
        """CPU seconds counted so far."""
        return self._cpu_time() - self._cpu

    @contextmanager
    def paused(self) -> Iterator[float]:
        """Stop counting inside the block; yields the seconds counted before it."""
        wall, cpu = time.perf_counter(), self._cpu_time()
        try:
            yield wall - self._wall
        finally:
            self._wall += time.perf_counter() - wall
            self._cpu += self._cpu_time() - cpu


def duration(seconds: float) -> str:
    """`45 s`, `3 min 20 s`, `2 h 5 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s" if seconds >= 1 else "less than 1 s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
