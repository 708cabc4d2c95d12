"""A forest plot as data: differences with their intervals below each other, zero marked.

A thick bar is an interval that holds for all comparisons of the report at once, a thin one belongs
to its row alone. A mark is filled where a thick bar excludes zero, which is what the text calls
really different.
"""

from __future__ import annotations

import textwrap
from dataclasses import dataclass

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from framework.report.parts.draw import STYLE, WIDTH, lay_out
from framework.report.parts.palette import LIGHT, MARKERS, color_index, marker_index

ROW, MARGIN = 0.23, 0.95  # inches, of a row and of all else
LABEL_CHARACTERS, NAME_CHARACTERS = 34, 76


@dataclass(frozen=True)
class Row:
    """method: what is compared, with its look. label: on what. low, high: the interval, None of a
    single run. joint: a thick bar. real: a filled mark."""

    method: str
    label: str
    look: int
    middle: float
    low: float | None
    high: float | None
    joint: bool
    real: bool


@dataclass(frozen=True)
class Forest:
    """name: of its files. against: the baseline. min_span: that the axis shows at least."""

    name: str
    against: str
    x_label: str
    rows: tuple[Row, ...]
    min_span: float


def limits(forest: Forest) -> tuple[float, float]:
    """Of the axis: zero and every thick bar are inside; a thin one may be cut, at three times what
    the thick ones need."""

    def ends(rows: list[Row]) -> list[float]:
        return [v for r in rows for v in (r.low, r.middle, r.high) if v is not None] + [0.0]

    thick = ends([row for row in forest.rows if row.joint] or list(forest.rows))
    every = ends(list(forest.rows))
    low, high = min(thick), max(thick)
    reach = max(high - low, forest.min_span)
    low, high = max(min(every), low - reach), min(max(every), high + reach)
    missing = max(0.0, forest.min_span - (high - low)) / 2
    pad = 0.04 * max(high - low, forest.min_span)
    return low - missing - pad, high + missing + pad


def draw(forest: Forest) -> Figure:
    """The rows from top to bottom; a method's name stands above its rows."""
    with matplotlib.rc_context(STYLE):
        places, names = _places(forest)
        height = ROW * (max([*places, *(at for at, _ in names)]) + 1.5) + MARGIN
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        axes = figure.subplots()
        _draw_rows(axes, forest, places)
        for at, name in names:
            words = axes.annotate(
                textwrap.shorten(name, NAME_CHARACTERS, placeholder=" …"), (0, at), (4, 0),
                xycoords=("axes fraction", "data"), textcoords="offset points",
                va="center", weight="bold", parse_math=False,
            )  # fmt: skip
            words.set_in_layout(False)  # it lies inside the axes, however long
        labels = [_shortened(row.label) for row in forest.rows]
        axes.set_yticks(places, labels, parse_math=False)
        axes.set_ylim(max([*places, *(at for at, _ in names)]) + 0.8, -0.8)
        axes.set_xlim(*limits(forest))
        axes.set_xlabel(forest.x_label, parse_math=False)
        axes.grid(axis="x", alpha=0.3, linewidth=0.6)
        axes.tick_params(axis="y", length=0)
        lay_out(figure)
    return figure


def csv_rows(forest: Forest) -> list[dict[str, object]]:
    """The numbers of the figure."""
    return [
        {
            "method": row.method,
            "against": forest.against,
            "on": row.label,
            "difference_db": row.middle,
            "low": row.low,
            "high": row.high,
            "interval": "all comparisons at once" if row.joint else "this row alone",
        }
        for row in forest.rows
    ]


def _places(forest: Forest) -> tuple[list[float], list[tuple[float, str]]]:
    """The height of every row, and of the methods' names where they have one of their own."""
    places: list[float] = []
    names: list[tuple[float, str]] = []
    at, last = 0.0, None
    for row in forest.rows:
        if row.label != row.method and row.method != last:
            names.append((at, row.method))
            at += 1
        last = row.method
        places.append(at)
        at += 1
    return places, names


def _draw_rows(axes: Axes, forest: Forest, places: list[float]) -> None:
    axes.axvline(0, color="0.35", linewidth=1)
    for row, at in zip(forest.rows, places, strict=True):
        color = LIGHT[color_index(row.look)]
        if row.low is not None and row.high is not None:
            width = 3.2 if row.joint else 1.0
            axes.plot([row.low, row.high], [at, at], color=color, linewidth=width,
                      solid_capstyle="butt", alpha=1 if row.joint else 0.75)  # fmt: skip
        axes.plot(
            [row.middle], [at], marker=MARKERS[marker_index(row.look)], color=color,
            markersize=8 if row.joint else 5, linestyle="none",
            markerfacecolor=color if row.real else "white", markeredgewidth=1.4,
        )  # fmt: skip


def _shortened(label: str) -> str:
    return textwrap.fill(textwrap.shorten(label, 2 * LABEL_CHARACTERS, placeholder=" …"),
                         LABEL_CHARACTERS)  # fmt: skip
