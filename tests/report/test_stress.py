"""What a report says about a method along a stress."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from framework.compute.rng import stream
from framework.report.figures.charts import stress_charts
from framework.report.render import say
from framework.report.statistics.breakdown import break_down, gains_of_levels
from framework.report.stress import Limit, limits, panels
from framework.report.study.axes import STRESSES
from framework.report.study.collect import collect
from framework.report.study.methods import PLAIN, Method
from tests.record.fakes import fake_run
from tests.report.studies import first_screen, row, table

UAR = Method("none", "uar")
VIEWS = next(axis for axis in STRESSES if axis.short == "n_views")
STRENGTH = next(axis for axis in STRESSES if axis.short == "strength")
NOISE = np.array([-0.02, 0.0, 0.02])  # dB, of three seeds


def limit(axis: Any, levels: list[float], gains: list[float], spread: float = 1.0) -> Limit:
    panel = cast(Any, SimpleNamespace(axis=axis, levels=levels, title="s"))
    every = np.array(gains)[:, None] + spread * NOISE
    drawn = tuple(gains_of_levels(every))
    broken = break_down(np.array(levels), every)
    return Limit(panel, UAR, PLAIN, broken, tuple(levels), drawn)


def course(limit: Limit) -> str:
    findings = SimpleNamespace(study=SimpleNamespace(baseline=limit.against))
    return say("course_of", findings=findings, limit=limit)


@pytest.mark.parametrize(
    ("axis", "levels", "gains", "expected"),
    [
        (VIEWS, [9, 3, 2], [0.01, 0.0, -0.01], "UAR: no significant difference at any strength ("),
        (VIEWS, [9, 3, 2], [-0.5, -0.4, -0.3], "UAR costs quality at every tested strength ("),
        (VIEWS, [9, 4, 2], [0.5, 0.4, 0.3], "UAR helps at every tested strength ("),
        (
            *(VIEWS, [9, 4, 2], [-0.5, -0.5, 0.5]),
            "UAR helps at 2 training views and costs quality at 9 and 4 training views (",
        ),
        (VIEWS, [9, 4, 2], [-0.5, -0.01, 0.01], "UAR costs quality at 9 training views ("),
        (
            *(STRENGTH, [0, 0.5, 1], [0.5, 0.5, -0.5]),
            "UAR helps at strength 0 and 0.5 and costs quality at strength 1, and stops helping at"
            " strength 0.75 (",
        ),
        (STRENGTH, [0, 0.5, 1], [0.01, -0.01, -0.5], "UAR costs quality at strength 1 ("),
    ],
)
def test_the_sentence(axis: Any, levels: list[float], gains: list[float], expected: str) -> None:
    assert course(limit(axis, levels, gains)).startswith(expected)


def test_intervals_hold_for_all_methods_and_panels_at_once(tmp_path: Path) -> None:
    """Two methods at three numbers of views: six comparisons; what is drawn is what is said."""
    for augment in ("none", "dba", "safi"):
        for views in (2, 3, 4):
            for seed in range(3):
                name = f"{augment}-{views}-{seed}"
                fake_run(tmp_path, augment, seed=seed, run_name=name, condition={"n_views": views})
    study = collect(tmp_path)
    (panel,) = panels(study)
    actual = limits(study, [panel])
    assert len(actual) == 2
    for ours in actual:
        for level, (mean, inside) in zip(ours.levels, ours.gains, strict=True):
            mine, base = (
                np.array([float(run.mean("psnr") or 0) for run in panel.runs[method][level]])
                for method in (ours.method, ours.against)
            )
            gains = mine - base
            alone = stats.sem(gains) * stats.t.ppf(1 - 0.05 / 2 / 6, 2)
            assert inside is not None and mean == pytest.approx(np.mean(gains))
            assert inside.high - mean == pytest.approx(alone, rel=1e-6)
    drawn = stress_charts(study, panel, actual, "x")[1].series
    assert [p.y_high for s in drawn for p in s.points] == [
        inside.high for ours in actual for _, inside in ours.gains if inside
    ]


@pytest.mark.parametrize(
    ("option", "values", "titles"),
    [
        ("split", ("llff_drawn0", "llff_drawn1"), ("fern (split=llff_drawn0)",)),
        ("path", ("/a/fern", "/b/fern"), ("fern (path=/a/fern)", "fern (path=/b/fern)")),
    ],
)
def test_draws_and_folders_have_panels_of_their_own(
    tmp_path: Path, option: str, values: tuple[str, str], titles: tuple[str, ...]
) -> None:
    """What costs with the first of them helps with the second; no run is dropped."""
    rows = [
        row(f"fern (n_views={views}, {option}={value})", method, seed, 20.0 + ours,
            **{f"scene.{option}": value, "scene.n_views": views})
        for value, gain in zip(values, (-1.0, 1.0), strict=True)
        for views in (3, 6, 9)
        for method, ours in (("none + none", 0.0), ("safi + none", gain))
        for seed in range(4)
    ]  # fmt: skip
    study = collect(table(tmp_path, rows))
    shown = panels(study)
    assert len(shown) == 2 and {*titles} <= {panel.title for panel in shown}
    cells = [runs for panel in shown for by in panel.runs.values() for runs in by.values()]
    assert all([run.seed for run in runs] == [0, 1, 2, 3] for runs in cells)
    assert sum(map(len, cells)) == len(rows)
    costs, helps = map(course, limits(study, shown))
    assert costs.startswith("SAFI costs quality at every tested strength")
    assert helps.startswith("SAFI helps at every tested strength")


def test_all_views_and_their_number_are_pairs_of_one_strength(tmp_path: Path) -> None:
    """Both labels have nine views: a seed has the mean of both."""
    cells = {"3": (3, 0.5), "all": (9, 0.2), "9": (9, 0.6)}
    rows = [
        row(f"fern (n_views={name})", method, seed, str(20.0 + ours), **{"scene.n_views": views})
        for name, (views, gain) in cells.items()
        for method, ours in (("none + none", 0.0), ("safi + none", gain))
        for seed in range(3)
    ]
    study = collect(table(tmp_path, rows))
    (panel,) = panels(study)
    (actual,) = limits(study, [panel])
    assert actual.breakdown.n == 3 and actual.levels == (9, 3)
    assert [mean for mean, _ in actual.gains] == pytest.approx([0.4, 0.5])


def test_the_verdict_of_a_stress(tmp_path: Path) -> None:
    for views in (2, 3, 4):
        for augment, gain in (("none", 0.0), ("safi", 6.0), ("dba", -6.0), ("euclidean", 0.0)):
            for seed in range(3):
                fake_run(tmp_path, augment, seed=seed, gain=gain, condition={"n_views": views},
                         run_name=f"{augment}{views}{seed}")  # fmt: skip
    text = first_screen(tmp_path)
    assert "**Use SAFI where it helps (below), the baseline elsewhere.**" in text
    assert "- DBA costs up to " in text and "- SAFI gains up to " in text
    assert "- Not significant at any strength: Euclidean; an effect of up to " in text


def test_bars_and_sentences_agree() -> None:
    """What is said to differ is what the drawn interval says, at every strength."""
    draw = stream(0, "bars")
    for _ in range(200):
        gains = 0.3 * draw.standard_normal((5, 3))
        actual = break_down(np.arange(5.0), gains)
        for sign, (_, interval) in zip(actual.signs, gains_of_levels(gains), strict=True):
            assert interval is not None
            assert (sign == 0) == (interval.low <= 0 <= interval.high)


def test_noise_is_no_difference() -> None:
    assert "no significant" in course(limit(VIEWS, [9, 4, 2], [-0.5, -0.5, 0.5], spread=50))
