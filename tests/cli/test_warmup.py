"""The warm-up remembers what it compiled, and only that."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework import warmup
from framework.progress import Silent
from framework.warmup import Warmup
from tests.cli.conftest import composed


@pytest.fixture(autouse=True)
def _elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(warmup, "KERNEL_CACHE", tmp_path)
    monkeypatch.setattr(warmup, "_start_beside", lambda depth: None)
    monkeypatch.setattr(warmup, "_estimate", lambda depth, training: None)
    monkeypatch.setattr(warmup, "_warm", set())


def test_one_that_failed_is_announced_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fails(*_: object) -> None:
        raise RuntimeError("a broken plugin")

    config = composed()
    monkeypatch.setattr(warmup, "_train", fails)
    Warmup(config, Silent()).finish()
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(warmup, "_warm", set())
    assert Warmup(config, Silent()).compiles
    monkeypatch.setattr(warmup, "_train", lambda *_: None)
    Warmup(config, Silent()).finish()
    monkeypatch.setattr(warmup, "_warm", set())
    assert not Warmup(config, Silent()).compiles


def test_another_value_is_warmed_up_without_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    trained: list[object] = []
    monkeypatch.setattr(warmup, "_train", lambda config, *_: trained.append(config))
    for form in ("block", "diagonal", "diagonal"):
        Warmup(composed("reg=uar", f"reg.form={form}"), Silent()).finish()
    assert len(trained) == 2
    assert not Warmup(composed("reg=uar", "reg.p=0.2"), Silent()).compiles
