"""A chart as a figure, for its files."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection, Sequence
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from framework.report.parts.chart import Chart, Series
from framework.report.parts.palette import (
    DASHES,
    LIGHT,
    MARKERS,
    color_index,
    dash_index,
    marker_index,
)

STYLE: Any = {
    "svg.hashsalt": "fishersplat",
    "svg.fonttype": "path",
    "text.parse_math": False,  # a name with $ in it is no formula
    "font.size": 10.0,
    "axes.titlesize": 10.0,
}
WIDTH = 7.2  # inches; 792 pixels at 110 dpi, so that text keeps its size at 800 pixels
LEGEND_CHARACTERS = 44
LEGEND_ROW, LEAST_AXES = 0.21, 3.4  # inches: a line of the legend; a chart above a long one
DODGE = 0.009  # of the range of x, between neighbouring series


def draw(charts: Sequence[Chart]) -> Figure:
    """The charts below each other with one legend; they share their series' names."""
    with matplotlib.rc_context(STYLE):
        names = {s.name for chart in charts for s in chart.series if not s.faint}
        height = 3.7 * len(charts) + 0.6 + 0.1 * max(0, len(names) - 6)  # room for the legend
        told = names | {chart.band.name for chart in charts if chart.band is not None}
        height = max(height, LEAST_AXES * len(charts) + LEGEND_ROW * _legend_rows(told))
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        column = figure.subplots(len(charts), squeeze=False)[:, 0]
        for axes, chart in zip(column, charts, strict=True):
            _draw_chart(axes, chart)
        _draw_legend(figure)
        lay_out(figure)
    return figure


def lay_out(figure: Figure) -> None:
    """Once for all file formats; with an engine left, each would be drawn twice."""
    engine = figure.get_layout_engine()
    assert engine is not None, "the figure was made with one"
    engine.execute(figure)
    figure.set_layout_engine(None)


def _draw_legend(figure: Figure) -> None:
    """One entry per name below all charts."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        figure.legend(
            list(entries.values()),
            list(entries),
            loc="outside lower center",
            ncols=_legend_columns(list(entries)),
            frameon=False,
            handlelength=3.2,
        )


def _legend_columns(labels: Sequence[str]) -> int:
    longest = max(len(line) for label in labels for line in label.splitlines())
    return 1 if longest > 36 else 2 if longest > 22 or len(labels) < 3 else 3


def _legend_rows(names: Collection[str]) -> int:
    """Lines of text in the legend's longest column."""
    labels = [textwrap.fill(name, LEGEND_CHARACTERS) for name in names]
    lines = sum(label.count("\n") + 1 for label in labels)
    return math.ceil(lines / _legend_columns(labels)) if labels else 0


def _draw_chart(axes: Axes, chart: Chart) -> None:
    if chart.log_x:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
    if chart.y_zero:
        axes.axhline(0, color="0.45", linewidth=0.9)
    xs = [point.x for series in chart.series for point in series.points]
    shift = DODGE * (max(xs) - min(xs)) if chart.dodge else 0.0
    for number, series in enumerate(chart.series):
        _draw_series(axes, series, shift * (number - (len(chart.series) - 1) / 2))
    axes.set_title(textwrap.fill(chart.title, 84))
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(chart.y_label)
    axes.grid(alpha=0.3, linewidth=0.6)
    if chart.reverse_x:
        axes.invert_xaxis()
    if chart.band is not None:
        axes.axhspan(
            chart.band.low, chart.band.high, color="0.9", zorder=0, linewidth=0,
            label=textwrap.fill(chart.band.name, LEGEND_CHARACTERS),
        )  # fmt: skip
    low, high = axes.get_ylim()
    missing = chart.min_span - (high - low)
    if missing > 0:
        axes.set_ylim(low - missing / 2, high + missing / 2)


def _draw_series(axes: Axes, series: Series, shift: float) -> None:
    color, marker = LIGHT[color_index(series.look)], MARKERS[marker_index(series.look)]
    dash = (0, DASHES[dash_index(series.look)]) if DASHES[dash_index(series.look)] else "-"
    x, y = [p.x + shift for p in series.points], [p.y for p in series.points]
    if series.faint:
        line = {"alpha": 0.35, "linewidth": 0.8, "linestyle": dash}
        dots = {"alpha": 0.5, "linestyle": "none", "marker": marker, "markersize": 4}
        style: Any = line if series.joined else dots
        axes.plot(x, y, color=color, **style)
        return
    errors = [[p.y - p.y_low for p in series.points], [p.y_high - p.y for p in series.points]]
    has_errors = any(map(any, errors))
    label = textwrap.fill(series.name, LEGEND_CHARACTERS)
    if has_errors:
        axes.errorbar(x, y, errors, color=color, fmt="none", elinewidth=1.1, capsize=3)
    axes.plot(x, y, color=color, linestyle=dash if series.joined else "none", linewidth=1.8,
              marker=marker, markersize=5.5, label=label)  # fmt: skip
    ringed = [series.points[k] for k in series.ringed]
    axes.plot([p.x for p in ringed], [p.y for p in ringed], linestyle="none", marker="o",
              markersize=13, markerfacecolor="none", markeredgecolor="0.35")  # fmt: skip
