"""What a report says of the number of Gaussians along a stress."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from framework.report.figures import modelsize
from framework.report.figures.stress import Panel
from framework.report.parts.draw import draw
from framework.report.study.axes import STRESSES

VIEWS = next(axis for axis in STRESSES if axis.short == "n_views")


def panel(**sizes: tuple[int, ...]) -> Panel:
    """By capacity, the Gaussians with 9, 6 and 3 views; two seeds, one of them 10 above."""

    def runs(method: str, size: int) -> list[Any]:
        methods = {"capacity": method}
        return [
            SimpleNamespace(record=SimpleNamespace(gaussians=n, methods=methods))
            for n in (size, size + 10)
        ]

    levels = (9.0, 6.0, 3.0)
    by_method = {
        method: {level: runs(method, size) for level, size in zip(levels, of, strict=True)}
        for method, of in sizes.items()
    }
    return Panel("room", VIEWS, levels, by_method)


def test_growth_is_told_from_the_hardest_strength_on() -> None:
    told = modelsize.told(panel(evidence=(8000, 5000, 3000), fixed=(700, 700, 700)))
    assert told == [
        "evidence: 3,005 / 5,005 / 8,005 Gaussians at 3 / 6 / 9 training views.",
        "fixed: 705 Gaussians at every strength.",
    ]


def test_nothing_is_told_where_no_number_changes() -> None:
    same = panel(fixed=(700, 700, 700), other=(900, 901, 902))
    study: Any = SimpleNamespace(methods=["fixed", "other"])
    assert modelsize.told(same) == [] and modelsize.chart(study, same, "name") is None


def test_nothing_is_told_where_only_the_start_grows() -> None:
    assert modelsize.told(panel(fixed=(8000, 5000, 3000))) == []


def test_the_chart_has_every_method_with_its_interval() -> None:
    study: Any = SimpleNamespace(methods=["fixed", "evidence"])
    found = panel(fixed=(700, 700, 700), evidence=(8000, 5000, 3000))
    made = modelsize.chart(study, found, "name")
    assert made is not None and made.reverse_x
    assert [s.name for s in made.series] == ["fixed", "evidence"]
    assert len({s.look for s in made.series}) == 2
    first = made.series[1].points[0]
    assert (first.x, first.y) == (9.0, 8005.0) and first.y_low < 8005 < first.y_high
    assert draw([made]).axes[0].get_ylabel() == "Gaussians"
