"""What the child process tells its parent: a JSON object a line."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import TextIO

from framework.compute.stopwatch import duration


class Telling:
    """label: what is being done, before what `ticks` tell every `period_s` seconds."""

    def __init__(self, out: TextIO, period_s: float) -> None:
        self._out, self._period_s = out, period_s
        self._told_at = time.monotonic()
        self.label = "poses"

    def say(self, text: str) -> None:
        """A line that stays."""
        self._write({"say": text})

    def error(self, text: str) -> None:
        """The search ends with it."""
        self._write({"error": text})

    def ticks(self, what: str) -> Callable[[int, int], None]:
        """A counter to be called with (done, total): it tells both and the time left."""
        started = time.monotonic()

        def tick(done: int, total: int) -> None:
            now = time.monotonic()
            if now - self._told_at < self._period_s:
                return
            self._told_at = now
            left = (now - started) / done * (total - done) if done else 0.0
            rest = f", {duration(left)} left" if left >= 1 else ""
            self._write({"say": f"{self.label}: {done} of {total} {what}{rest}", "passing": True})

        return tick

    def _write(self, told: dict[str, object]) -> None:
        print(json.dumps(told), file=self._out, flush=True)
