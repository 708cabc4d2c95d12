"""`fishersplat report DIR --baseline METHOD`: all are compared with that method."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import pytest

from framework.errors import UserError
from framework.report import build_report
from framework.report.statistics.outcomes import outcomes
from framework.report.statistics.robustness import failure_rate
from framework.report.study.collect import collect
from tests.record.fakes import fake_run, make_config

GAINS = {("none", "none"): 0.0, ("none", "uar"): 1.0, ("safi", "none"): 1.6}


@pytest.fixture
def study(tmp_path: Path) -> Path:
    for (augment, reg), gain in GAINS.items():
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    return tmp_path


def test_all_are_compared_with_the_method_that_was_named(study: Path) -> None:
    found = outcomes(collect(study, rival="none + uar"))
    assert {c.baseline for c in found.comparisons.values()} == {"none + uar"}
    plain, uar, safi = (found.psnr[m].mean for m in ("none + none", "none + uar", "safi + none"))
    gains = {method: c.difference for method, c in found.comparisons.items()}
    assert gains == pytest.approx({"none + none": plain - uar, "safi + none": safi - uar})
    assert found.best == "safi + none"


def test_the_report_says_so(study: Path) -> None:
    plain = build_report(study).read_text(encoding="utf-8")
    text = build_report(study, rival="none + uar").read_text(encoding="utf-8")
    assert "As `--baseline` asks, methods are compared with none + uar." in text
    assert "against none + uar" in text.partition("## ")[0]
    assert "--baseline" not in plain and "against none + uar" not in plain
    assert build_report(study).read_text(encoding="utf-8") == plain


def test_a_rival_that_nothing_beats_is_not_advised(study: Path) -> None:
    text = build_report(study, rival="safi + none").read_text(encoding="utf-8")
    assert "**Nothing was shown to be better than safi + none on embedded.**" in text
    assert "Use " not in text.partition("## ")[0]


def test_what_beats_the_rival_alone_is_told(tmp_path: Path) -> None:
    """Better than the rival, and not than another baseline of the study: no "nothing" then."""
    for (augment, reg), gain in {("none", "uar"): 0.0, ("safi", "none"): 3.0}.items():
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    text = build_report(tmp_path, rival="none + uar").read_text(encoding="utf-8")
    assert "Nothing was shown" not in text and "**Use safi + none" in text


def test_runs_fail_by_plain_training_whoever_is_the_rival(tmp_path: Path) -> None:
    for (augment, reg), gain in {("none", "none"): 0.0, ("none", "uar"): -5.0}.items():
        for seed in range(3):
            fake_run(tmp_path, augment, reg, seed, gain)
    for rival in ("", "none + uar"):
        assert failure_rate(collect(tmp_path, rival=rival), "none + uar") is not None
        text = build_report(tmp_path, rival=rival).read_text(encoding="utf-8")
        assert "3 of 3" in text.partition("## Worst case")[2].partition("\n## ")[0]
        assert "has no `none + none` to compare with" not in text


def test_who_is_compared_with_another_is_told(tmp_path: Path) -> None:
    for (augment, reg), steps in product(GAINS, (100, 200)):
        if (reg, steps) != ("uar", 200):
            for seed in range(3):
                name = f"{augment}-{reg}-{steps}-{seed}"
                trainer = make_config()["trainer"] | {"steps": steps}
                fake_run(tmp_path, augment, reg, seed, run_name=name, trainer=trainer)
    text = build_report(tmp_path, rival="none + uar").read_text(encoding="utf-8")
    assert "none + uar, steps=100; where budget or options are others, with none + none" in text


def test_an_unknown_method_is_told_with_those_there_are(study: Path) -> None:
    told = "--baseline: expected a method of the report, got 'uar'; give one of none [+] none; none"
    with pytest.raises(UserError, match=told):
        build_report(study, rival="uar")


def test_budgets_are_compared_at_equal_budgets(tmp_path: Path) -> None:
    for (augment, reg), gain in GAINS.items():
        for steps, seed in product((100, 200), range(3)):
            name = f"{augment}-{reg}-{steps}-{seed}"
            trainer = make_config()["trainer"] | {"steps": steps}
            fake_run(tmp_path, augment, reg, seed, gain, run_name=name, trainer=trainer)
    study = collect(tmp_path, rival="none + uar")
    assert study.families == ["none + uar", "none + none", "safi + none"]
    told = {method: c.baseline for method, c in outcomes(study).comparisons.items()}
    uar = {"100": "none + uar, steps=100", "200": "none + uar, steps=200"}
    assert told == {
        f"{m}, steps={n}": uar[n] for m, n in product(("none + none", "safi + none"), uar)
    }
