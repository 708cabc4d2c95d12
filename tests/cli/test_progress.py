"""The progress line: sparse on a pipe, in place on a terminal."""

import io

import pytest

from framework.records.progress import Terminal

LABEL = "[run 4 of 12] safi+uar seed 1"


class Clock:
    """Advances by `pace_s` seconds a step."""

    def __init__(self, pace_s: float) -> None:
        self.now, self.pace_s = 0.0, pace_s

    def __call__(self) -> float:
        self.now += self.pace_s
        return self.now


def told(pace_s: float, in_place: bool, steps: int = 800) -> str:
    stream = io.StringIO()
    line = Terminal(LABEL, stream, in_place, Clock(pace_s))
    for step in range(1, steps + 1):
        line.step(step, steps, 0.0412, 39957, 22.31 if step > 100 else None)
    line.done("22.40 dB")
    return stream.getvalue()


def test_a_pipe_gets_a_line_every_tenth() -> None:
    lines = told(1 / 41, in_place=False).splitlines()
    assert len(lines) == 12
    assert lines[4] == (
        f"{LABEL} · step 321/800 · 12 s left · test 22.31 dB · loss 0.0412 · 39957 Gaussians"
        " · 41 steps/s"
    )
    assert lines[-2].startswith(f"{LABEL} · step 800/800 ·")
    assert lines[-1] == f"{LABEL} · 22.40 dB"
    assert "test" not in lines[0]


def test_a_terminal_gets_one_line_in_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "160")
    text = told(1 / 41, in_place=True)
    assert text.count("\n") == 1
    assert "step 800/800 · 0 s left · test 22.31 dB · loss 0.0412 · 39957 Gaussians" in text


def test_one_slow_step_does_not_decide_the_time_left() -> None:
    stream, clock = io.StringIO(), Clock(0.1)
    line = Terminal(LABEL, stream, False, clock)
    for step in range(1, 401):
        if step == 301:  # a round of pruning
            clock.now += 12
        line.step(step, 800, 0.0412, 39957)
    [told] = [text for text in stream.getvalue().splitlines() if "step 301/" in text]
    left = int(told.split(" s left")[0].rsplit(" ", 1)[1])
    assert 50 < left < 150  # 499 steps at 0.1 s; one step in 12 s would make 6,000
