"""Progress of a subcommand: how much is done, and the time left."""

from __future__ import annotations

import sys
import time
from typing import TextIO

from framework.compute.stopwatch import duration
from framework.records.progress import unread

PERIOD_S = {True: 0.2, False: 10.0}  # on a terminal, and elsewhere


class Ticks:
    """`tick(done, total)` tells of a piece of work. what: plural, as in `frames`."""

    def __init__(self, what: str, stream: TextIO | None = None) -> None:
        self._what, self._stream = what, stream if stream is not None else sys.stderr
        self._terminal = self._stream.isatty()
        self._started = self._told_at = time.monotonic()

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if done < total and now - self._told_at < PERIOD_S[self._terminal]:
            return
        self._told_at = now
        left = (now - self._started) / done * (total - done) if done else 0.0
        rest = f", {duration(left)} left" if left >= 1 else ""
        text = f"{done} of {total} {self._what}{rest}"
        try:
            if self._terminal:
                self._stream.write(f"\r\x1b[K{text}{'' if done < total else chr(10)}")
            else:
                self._stream.write(f"{text}\n")
            self._stream.flush()
        except BrokenPipeError:
            unread(self._stream)
