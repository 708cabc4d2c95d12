"""Seconds of a training leave out its evaluations, and never run backwards."""

from __future__ import annotations

import pytest

from framework.compute import stopwatch
from framework.compute.stopwatch import Stopwatch


class Clock:
    """Replaces the module `time`; every look at it takes a second."""

    def __init__(self) -> None:
        self.now = 0.0

    def perf_counter(self) -> float:
        self.now += 1
        return self.now

    process_time = thread_time = perf_counter


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(stopwatch, "time", clock)
    return clock


def test_a_pause_does_not_count(clock: Clock) -> None:
    watch = Stopwatch(wall_s=5)
    with watch.paused() as before:
        clock.now += 1000
        assert watch.wall_s > 1000  # the pause is reported separately
    after = watch.wall_s
    assert 5 < before < after < 20
