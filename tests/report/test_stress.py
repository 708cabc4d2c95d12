"""What a report says of a method along a stress."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from framework.report.figures.stress import Limit, sentence
from framework.report.statistics.breakdown import break_down
from framework.report.study.axes import STRESSES

VIEWS = next(axis for axis in STRESSES if axis.short == "n_views")
STRENGTH = next(axis for axis in STRESSES if axis.short == "strength")
NOISE = np.array([-0.02, 0.0, 0.02])  # dB, of three seeds


def told(axis: Any, levels: list[float], gains: list[float], spread: float = 1.0) -> str:
    panel = cast(Any, SimpleNamespace(axis=axis, levels=levels))
    every = np.array(gains)[:, None] + spread * NOISE
    ends = ((levels[0], gains[0]), (levels[-1], gains[-1]))
    return sentence(Limit(panel, "uar", break_down(np.array(levels), every), ends))


@pytest.mark.parametrize(
    ("axis", "levels", "gains", "expected"),
    [
        (VIEWS, [9, 3, 2], [0.01, 0.0, -0.01], "uar: no significant difference at any strength"),
        (VIEWS, [9, 3, 2], [-0.5, -0.4, -0.3], "uar helps at no tested strength"),
        (VIEWS, [9, 4, 2], [0.5, 0.4, 0.3], "uar helps from 9 training views to 2 training views"),
        (VIEWS, [9, 4, 2], [-0.5, -0.5, 0.5], "uar begins to help at 3 training views and does"),
        (
            *(VIEWS, [9, 4, 2], [-0.5, -0.01, 0.01]),
            "uar gains nothing significant and costs quality above 3 training views",
        ),
        (STRENGTH, [0, 0.5, 1], [0.5, 0.5, -0.5], "uar stops helping at strength 0.75"),
        (
            *(STRENGTH, [0, 0.5, 1], [0.01, -0.01, -0.5]),
            "uar gains nothing significant and costs quality above strength 0.25",
        ),
        (
            *(STRENGTH, [0, 0.5, 1], [-0.5, 0.01, -0.01]),
            "uar gains nothing significant and costs quality below strength 0.49 and above",
        ),
    ],
)
def test_the_sentence(axis: Any, levels: list[float], gains: list[float], expected: str) -> None:
    assert told(axis, levels, gains).startswith(expected)


def test_noise_is_told_as_such() -> None:
    assert "no significant difference" in told(VIEWS, [9, 4, 2], [-0.5, -0.5, 0.5], spread=50)
