"""The warm-up remembers what it compiled, and only that."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from framework.compute.parallel import in_task, set_threads
from framework.records.notices import QUIET
from framework.records.progress import Silent
from framework.run import warmup
from framework.run.warmup import Warmup
from framework.train.descent import Regularization
from framework.train.optim import Adam
from framework.train.plugin_calls import PluginCalls
from tests.cli.conftest import composed


@pytest.fixture(autouse=True)
def _elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[None]:
    monkeypatch.setattr(warmup, "KERNEL_CACHE", tmp_path)
    monkeypatch.setattr(warmup, "_start_beside", lambda depth: None)
    monkeypatch.setattr(warmup, "_estimate", lambda depth, training: None)
    monkeypatch.setattr(warmup, "_warm", set())
    yield
    set_threads(0)


def warm(config: Any) -> None:
    with Warmup(config, Silent()) as warmup:
        warmup.begin()
        warmup.finish()


def test_what_is_compiled_already_is_loaded_beside(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent thread does it, and its failure does not affect the run."""
    config, seen = composed(), list[tuple[str, bool]]()

    def loads(*_: object) -> None:
        seen.append((threading.current_thread().name, in_task()))
        raise RuntimeError("a broken plugin")

    monkeypatch.setattr(warmup, "_train", lambda *_: None)
    warm(config)
    for n, expected in ((2, (QUIET, True)), (1, (threading.current_thread().name, True))):
        monkeypatch.setattr(warmup, "_warm", set())
        monkeypatch.setattr(warmup, "_train", loads)
        set_threads(n)
        warm(config)
        assert seen.pop() == expected and not seen
        warm(config)
        assert not seen  # once per process


def test_a_run_that_ends_early_waits_for_what_it_loads(monkeypatch: pytest.MonkeyPatch) -> None:
    config, ended = composed(), list[bool]()
    monkeypatch.setattr(warmup, "_train", lambda *_: None)
    warm(config)
    monkeypatch.setattr(warmup, "_warm", set())
    monkeypatch.setattr(warmup, "_train", lambda *_: (time.sleep(0.2), ended.append(True)))
    set_threads(2)
    with pytest.raises(ValueError, match="depth"), Warmup(config, Silent()) as warmup_:
        warmup_.begin()
        raise ValueError("depth")
    assert ended == [True]


def test_both_ways_of_a_gradient_are_warmed_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """A regularizer's loss term, which the warm-up has in all of its steps and a run perhaps not in
    its first, keeps them from one of the two."""

    def penalty(*_: object) -> float:
        return 0.0

    ways: list[str] = []
    for name in ("step", "step_from"):
        way = getattr(Adam, name)
        monkeypatch.setattr(
            Adam, name, lambda *inputs, way=way, name=name: (ways.append(name), way(*inputs))[1]
        )
    monkeypatch.setattr(
        PluginCalls, "regularization", lambda *_: Regularization(penalty=lambda _: penalty)
    )
    warm(composed("trainer.sh_degree=1"))
    assert set(ways) == {"step", "step_from"}


def test_compiling_is_told_once_and_only_where_something_compiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    import numba

    def compiles(*_: object) -> None:
        for add in (1, 2):
            numba.njit(lambda x, add=add: x + add)(1)

    class Recorder(Silent):
        def __init__(self) -> None:
            self.lines: list[str] = []

        def compiling(self, what: str) -> None:
            self.lines.append(what)

        def note(self, text: str) -> None:
            self.lines.append(text)

    recorder = Recorder()
    for part in ("_train", "_initialize"):
        monkeypatch.setattr(warmup, part, lambda *_: None)
    with Warmup(composed(), recorder) as nothing:
        nothing.begin()
        nothing.finish()
    assert recorder.lines == []
    monkeypatch.setattr(warmup, "_train", compiles)
    with Warmup(composed("capacity=adc"), recorder) as something:
        something.begin()
        something.finish()
    assert [line.split(":")[0] for line in recorder.lines] == [
        warmup.FIRST.split(":")[0],
        recorder.lines[1],
    ]
    assert recorder.lines[1].startswith("2 kernels compiled in ")
