"""Charts as data, drawn once with matplotlib as PNG, as SVG for the page, and as CSV.

Points show 95 % confidence intervals where there are any. An axis of PSNR spans at least
`min_span`, so that noise does not look like a difference. Files hold neither a date nor random ids.
"""

import io
import itertools
import math
import re
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from framework.files.whole import write_whole
from framework.records.run_files import csv_text
from framework.report.figures.palette import LIGHT, Look, look_of

MIN_SPAN_DB = 1.0  # of an axis of PSNR or of its differences
STYLE: Any = {
    "svg.hashsalt": "fishersplat",
    "svg.fonttype": "none",
    "text.parse_math": False,  # a name with $ in it is no formula
    "font.size": 10.0,
    "axes.titlesize": 10.0,
}
FORMATS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None}},
    "png": {"metadata": {"Software": None}},
}
WIDTH, DPI = 5.4, 147  # inches; 793 pixels
LEGEND_CHARACTERS, TITLE_CHARACTERS = 44, 62
LEGEND_ROW, CHART = 0.21, 2.9  # inches
DODGE = 0.009  # of the range of x, between neighbouring series
COLORS = {  # of a figure -> of the page, which has a dark form
    **{color.lower(): f"var(--s{k})" for k, color in enumerate(LIGHT)},
    **{"#ffffff": "var(--bg)", "#e6e6e6": "var(--line)"},
    **{"#737373": "var(--muted)", "#595959": "var(--muted)"},
}


@dataclass(frozen=True)
class Point:
    """x, y.

    Attributes:
        y_low, y_high: interval, equal to y without one.
        note: for the table of the points.
    """

    x: float
    y: float
    y_low: float
    y_high: float
    note: str = ""


@dataclass(frozen=True)
class Series:
    """A line or a set of marks.

    Attributes:
        look: index of a style of `framework.report.figures.palette`.
        method: index of the method for the page's filter; None for a series that is always shown.
        faint: draw it thin and without a legend entry.
        joined: connect the points.
        ringed: indices of the points to mark.
    """

    name: str
    look: int
    points: tuple[Point, ...]
    method: int | None = None
    faint: bool = False
    joined: bool = True
    ringed: tuple[int, ...] = ()


@dataclass(frozen=True)
class Chart:
    """Series on one pair of axes.

    Attributes:
        name: stem of its files.
        reverse_x: larger values to the left.
        dodge: shift series sideways a little, because they share their x.
        y_zero: draw a line at 0.
        min_span: least span of the y axis.
    """

    name: str
    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    log_x: bool = False
    reverse_x: bool = False
    dodge: bool = False
    y_zero: bool = False
    min_span: float = 0.0


@dataclass(frozen=True)
class Picture:
    """A figure of the report.

    Attributes:
        files: names relative to the report; the first one is shown.
        caption: caption of photos. Captions of charts are in the templates.
        svg: the chart for the page; "" for photos.
    """

    files: tuple[str, ...]
    alt: str
    caption: str = ""
    svg: str = ""


def chart_picture(out_dir: Path, charts: Sequence[Chart], alt: str) -> Picture:
    """Draw the charts into one file of each kind, named after the first."""
    rows = [row for chart in charts for row in _rows(chart)]
    return save_figure(out_dir, charts[0].name, draw(charts), rows, alt)


def save_figure(
    out_dir: Path, name: str, figure: Figure, rows: Sequence[Mapping[str, object]], alt: str
) -> Picture:
    """Write a figure and the table of its numbers."""
    content = {kind: save(figure, out_dir, name, kind) for kind in FORMATS}
    write_whole(out_dir / f"{name}.csv", csv_text(rows))
    files = tuple(f"{name}.{kind}" for kind in ("png", "svg", "csv"))
    return Picture(files, alt, svg=inline_svg(content["svg"].decode()))


def save(figure: Figure, folder: Path, name: str, kind: str) -> bytes:
    """Write one file of a figure; returns its content."""
    buffer = io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.savefig(buffer, format=kind, dpi=DPI, **FORMATS[kind])
    write_whole(folder / f"{name}.{kind}", buffer.getvalue())
    return buffer.getvalue()


def inline_svg(text: str) -> str:
    """A figure as an SVG element of the page.

    The page's policy forbids style attributes, so they become presentation attributes, in the
    page's colours. `data-method` and `data-scene` serve the page's filter.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    text = re.sub(r' (width|height)="[\d.]+pt"', "", text, count=2)
    text = re.sub(r' style="([^"]*)"', _as_attributes, text)
    return re.sub(r' id="(?:method|scene)[^"]*"', _as_data, text)


def _as_attributes(style: re.Match[str]) -> str:
    attributes = []
    for part in filter(str.strip, style[1].split(";")):
        key, _, value = (word.strip() for word in part.partition(":"))
        if key == "font":
            size = re.search(r"([\d.]+)px", value)
            attributes.append(f'font-size="{size[1] if size else 10}"')
            attributes += ['font-weight="bold"'] if "bold" in value else []
        else:
            attributes.append(f'{key}="{COLORS.get(value.lower(), value)}"')
    return "".join(f" {attribute}" for attribute in attributes)


def _as_data(gid: re.Match[str]) -> str:
    pairs = re.findall(r"(method|scene)(\d+)", gid[0])
    return "".join(f' data-{kind}="{number}"' for kind, number in pairs)


class Marks:
    """Gives the artists of a figure the ids from which the page's filter knows them."""

    def __init__(self) -> None:
        self._numbers = itertools.count()

    def set(self, artists: Iterable[Artist], method: int | None, scene: int | None = None) -> None:
        """Mark artists of a method, and of a scene."""
        kinds = (("method", method), ("scene", scene))
        name = "".join(f"{kind}{index}" for kind, index in kinds if index is not None)
        for artist in artists if name else ():
            artist.set_gid(f"{name}-{next(self._numbers)}")


def draw(charts: Sequence[Chart]) -> Figure:
    """The charts below each other with one legend; they share their series' names."""
    with matplotlib.rc_context(STYLE):
        names = {s.name for chart in charts for s in chart.series if not s.faint}
        height = CHART * len(charts) + LEGEND_ROW * _legend_rows(names)
        figure = Figure(figsize=(WIDTH, height), layout="constrained")
        column = figure.subplots(len(charts), squeeze=False)[:, 0]
        marks = Marks()
        for axes, chart in zip(column, charts, strict=True):
            _draw_chart(axes, chart, marks)
        _draw_legend(figure)
        lay_out(figure)
    return figure


def lay_out(figure: Figure) -> None:
    """Lay out once for all file formats; with an engine left, each would do it again."""
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
    return 1 if longest > 24 else 2 if longest > 12 or len(labels) < 3 else 3


def _legend_rows(names: Collection[str]) -> int:
    """Lines of text in the legend's longest column."""
    labels = [textwrap.fill(name, LEGEND_CHARACTERS) for name in names]
    lines = sum(label.count("\n") + 1 for label in labels)
    return math.ceil(lines / _legend_columns(labels)) if labels else 0


def _draw_chart(axes: Axes, chart: Chart, marks: Marks) -> None:
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
        artists = _draw_series(axes, series, shift * (number - (len(chart.series) - 1) / 2))
        marks.set(artists, series.method)
    axes.set_title(textwrap.fill(chart.title, TITLE_CHARACTERS))
    axes.set_xlabel(chart.x_label)
    axes.set_ylabel(textwrap.fill(chart.y_label, TITLE_CHARACTERS // 2))
    axes.grid(alpha=0.3, linewidth=0.6)
    if chart.reverse_x:
        axes.invert_xaxis()
    low, high = axes.get_ylim()
    missing = chart.min_span - (high - low)
    if missing > 0:
        axes.set_ylim(low - missing / 2, high + missing / 2)


def _draw_series(axes: Axes, series: Series, shift: float) -> list[Artist]:
    look: Look = look_of(series.look)
    x, y = [p.x + shift for p in series.points], [p.y for p in series.points]
    if series.faint:
        line = {"alpha": 0.35, "linewidth": 0.8, "linestyle": look.dash}
        dots = {"alpha": 0.5, "linestyle": "none", "marker": look.marker, "markersize": 4}
        style: Any = line if series.joined else dots
        return [*axes.plot(x, y, color=look.color, **style)]
    artists: list[Artist] = []
    errors = [[p.y - p.y_low for p in series.points], [p.y_high - p.y for p in series.points]]
    if any(map(any, errors)):
        bars = axes.errorbar(x, y, errors, color=look.color, fmt="none", elinewidth=1.1, capsize=3)
        artists += bars.get_children()
    artists += axes.plot(
        x, y, color=look.color, linestyle=look.dash if series.joined else "none", linewidth=1.8,
        marker=look.marker, markersize=5.5, label=textwrap.fill(series.name, LEGEND_CHARACTERS),
    )  # fmt: skip
    ringed = [series.points[k] for k in series.ringed]
    artists += axes.plot(
        [p.x for p in ringed], [p.y for p in ringed], linestyle="none", marker="o",
        markersize=13, markerfacecolor="none", markeredgecolor="0.35",
    )  # fmt: skip
    return artists


def _rows(chart: Chart) -> list[dict[str, object]]:
    """The numbers of the chart, a row per point."""
    return [
        {
            "chart": chart.title,
            "series": series.name,
            "x": point.x,
            "x_is": chart.x_label,
            "y": point.y,
            "y_is": chart.y_label,
            "low": point.y_low,
            "high": point.y_high,
            "note": point.note,
        }
        for series in chart.series
        for point in series.points
    ]
