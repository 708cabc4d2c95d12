"""What a run shows while it works: one line, updated in place on a terminal, sparse otherwise.

    [run 4 of 12] safi+uar seed 1 · step 300/800 · 12 s left · test 22.31 dB · loss 0.0412 ·
    39957 Gaussians · 41 steps/s

whose end a narrow terminal cuts off.

Speed is the mean over the last seconds, so that compilation and the coarse phase do not distort
the time left. Nothing here touches training: a run is the same with any `Progress`.
"""

import contextlib
import logging
import os
import shutil
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TextIO

SPEED_WINDOW_S = 5.0
TTY_PERIOD_S = 0.2
PLAIN_PERIOD_S = 10.0
PLAIN_SHARE = 0.1


def say(text: str) -> None:
    """Print a line at once; nothing if the stream has no reader any more, as after `| head`."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        unread(sys.stdout)


def unread(stream: TextIO) -> None:
    """Discard what is written to a stream without a reader, so that the run continues."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


@contextlib.contextmanager
def unwarned() -> Iterator[None]:
    """No warnings: what a method finds wrong with a trial of few steps is no news."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)


class Progress:
    """The listener that `run_experiment` reports to; this one shows nothing."""

    def stage(self, what: str) -> None:
        """A part other than training begins, for instance "plane-sweep depth"."""

    def compiling(self, what: str) -> None:
        """`what` is compiled now; only the first run of a checkout waits for it."""
        self.stage(f"compiling {what}")

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        """`step` of `n_steps` steps are done.

        Args:
            psnr: last test PSNR in dB, if there is one.
        """

    def note(self, text: str) -> None:
        """Something worth keeping on the screen."""

    def done(self, text: str) -> None:
        """The run is over; `text` is its result."""


class Silent(Progress):
    """Shows nothing; for tests and library use."""


class Parts:
    """Several trainings, perhaps at the same time, whose steps `whole` shows as one count of
    `n_steps`.

    Args:
        done: finished steps of each.
    """

    def __init__(self, whole: Progress, n_steps: int, done: Sequence[int]) -> None:
        self._whole, self._n_steps, self._done = whole, n_steps, list(done)
        self._lock = threading.Lock()

    def step(self, part: int, step: int, loss: float, gaussians: int, psnr: float | None) -> None:
        """As `Progress.step`, of one part."""
        with self._lock:
            self._done[part] = step
            self._whole.step(sum(self._done), self._n_steps, loss, gaussians, psnr)


class Part(Progress):
    """The part `index` of `parts`; its training calls `check` at every step."""

    def __init__(self, parts: Parts, index: int, check: Callable[[], None]) -> None:
        self._parts, self._index, self._check = parts, index, check

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        self._check()
        self._parts.step(self._index, step, loss, gaussians, psnr)


class Line:
    """The last line of a stream; on a terminal it is replaced in place."""

    def __init__(self, stream: TextIO, in_place: bool | None = None) -> None:
        self._stream = stream
        self.in_place = stream.isatty() if in_place is None else in_place
        self._start = "\r\x1b[K" if self.in_place else ""

    def show(self, text: str) -> None:
        """A line that the next one may replace."""
        if self.in_place:
            columns = shutil.get_terminal_size().columns - 1
            self._write(f"{self._start}{text[:columns]}")
        else:
            self.keep(text)

    def keep(self, text: str) -> None:
        """A line that stays."""
        self._write(f"{self._start}{text}\n")

    def _write(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except BrokenPipeError:
            unread(self._stream)


class Terminal(Progress):
    """Writes to `stream`: in place if `in_place`, else a line every 10 s or 10 % of the steps.

    Args:
        label: who speaks, for instance "[run 4 of 12] safi+uar seed 1".
        clock: seconds, monotonic.
        tested: whether there are test views.
    """

    def __init__(
        self,
        label: str,
        stream: TextIO | None = None,
        in_place: bool | None = None,
        clock: Callable[[], float] = time.monotonic,
        tested: bool = True,
    ) -> None:
        self._label = label
        self._line = Line(sys.stdout if stream is None else stream, in_place)
        self._clock, self._tested = clock, tested
        self._marks: deque[tuple[float, int]] = deque()  # (seconds, step), the speed window
        self._told_at = -float("inf")
        self._told_step = 0

    def stage(self, what: str) -> None:
        self._line.show(f"{self._label} · {what}")

    def note(self, text: str) -> None:
        self._line.keep(f"{self._label} · {text}")

    def done(self, text: str) -> None:
        self.note(text)

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        now = self._clock()
        self._mark(now, step, n_steps)
        if not self._due(now, step, n_steps):
            return
        self._told_at, self._told_step = now, step
        parts = [f"step {step}/{n_steps}"]
        speed = self._speed()
        if speed is not None:
            parts.append(f"{(n_steps - step) / speed:.0f} s left")
        if psnr is not None:
            parts.append(f"test {psnr:.2f} dB")
        if not self._tested:
            parts.append("not tested")
        parts += [f"loss {loss:.4f}", f"{gaussians} Gaussians"]
        if speed is not None:
            parts.append(f"{speed:.{0 if speed >= 10 else 1}f} steps/s")
        self.stage(" · ".join(parts))

    def _mark(self, now: float, step: int, n_steps: int) -> None:
        if self._marks and step <= self._marks[-1][1]:  # a new training began
            self._marks.clear()
        self._marks.append((now, step))
        fewest = max(2, PLAIN_SHARE * n_steps)  # so that one slow step does not decide
        while len(self._marks) > fewest and now - self._marks[0][0] > SPEED_WINDOW_S:
            self._marks.popleft()

    def _speed(self) -> float | None:
        """Steps per second over the window; None before there are two marks."""
        (first_s, first), (last_s, last) = self._marks[0], self._marks[-1]
        return (last - first) / (last_s - first_s) if last_s > first_s else None

    def _due(self, now: float, step: int, n_steps: int) -> bool:
        if step < self._told_step:
            self._told_step = 0
        waited = now - self._told_at
        if self._line.in_place:
            return waited >= TTY_PERIOD_S or step == n_steps
        covered = step - self._told_step >= PLAIN_SHARE * n_steps
        return waited >= PLAIN_PERIOD_S or covered or step == n_steps
