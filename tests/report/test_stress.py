"""What a report says about a method along a stress."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy import stats

from framework.report.figures.charts import stress_charts
from framework.report.render import say
from framework.report.statistics.breakdown import break_down, gains_of_levels
from framework.report.stress import Limit, limits, panels
from framework.report.study.axes import STRESSES
from framework.report.study.collect import collect
from framework.report.study.methods import PLAIN, Method
from tests.record.fakes import fake_run

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
        (
            *(VIEWS, [9, 4, 2], [-0.5, -0.5, 0.5]),
            "UAR helps at 2 training views and costs quality at 9 and 4 training views (",
        ),
        (
            *(STRENGTH, [0, 0.5, 1], [0.5, 0.5, -0.5]),
            "UAR helps at strength 0 and 0.5 and costs quality at strength 1, and stops helping at"
            " strength 0.75 (",
        ),
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
