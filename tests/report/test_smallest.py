"""The sentence that names the smallest model that is as good as the best."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from framework.records.record import RunRecord
from framework.report.figures import tradeoff
from framework.report.statistics.estimates import spread
from framework.report.text import budgets


def entry(method: str, psnr: float, gaussians: int) -> tradeoff.Entry:
    blank: dict[str, Any] = {"timings": {}, "provenance": {}, "config": {}, "overrides": ()}
    record = RunRecord(identity="", scene=None, gaussians=gaussians, sh_degree=1, **blank)
    run: Any = SimpleNamespace(record=record, mean=lambda _: psnr)
    size = 1e-6 * 92 * gaussians
    return tradeoff.Entry(method, method, "", spread([psnr]), 1.0, gaussians, size, (run,), psnr)


def told(monkeypatch: pytest.MonkeyPatch, *found: tradeoff.Entry) -> str | None:
    monkeypatch.setattr(budgets, "entries", lambda *_: list(found))
    study: Any = None
    return budgets.smallest(study, "embedded")


def test_the_smallest_of_the_good_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    text = told(
        monkeypatch,
        entry("fixed", 25.03, 16000),
        entry("evidence", 24.95, 4000),
        entry("few", 24.9, 9),
    )
    assert text is not None
    assert text.startswith("The smallest model within 0.1 dB of the best: evidence, 24.95 dB ")
    assert "with 4,000 Gaussians (92 k parameters, 368 kB)" in text and "the best: fixed" in text


def test_the_best_may_be_the_smallest(monkeypatch: pytest.MonkeyPatch) -> None:
    text = told(monkeypatch, entry("fixed", 25.0, 16000), entry("evidence", 25.1, 4000))
    assert text is not None and text.endswith("kB), the best itself.")


def test_models_of_one_size_need_no_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    assert told(monkeypatch, entry("a", 25.0, 100), entry("b", 25.1, 100)) is None
    assert told(monkeypatch, entry("a", 25.0, 100)) is None
