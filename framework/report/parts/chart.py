"""A chart as data: what the figure files and the interactive page both draw.

Points carry 95 % intervals in y (and x) where there are any. Line and marker of a series follow
from its look (`framework.report.parts.palette`). An axis of PSNR shows at least `min_span`, so that
noise is not drawn as large as a difference.
"""

from __future__ import annotations

from dataclasses import dataclass

MIN_SPAN_DB = 1.0  # of an axis of PSNR or of its differences


@dataclass(frozen=True)
class Point:
    """x, y; y_low, y_high: interval, equal to y where there is none. note: what it is."""

    x: float
    y: float
    y_low: float
    y_high: float
    note: str = ""


@dataclass(frozen=True)
class Series:
    """look: of its method. faint: thin, without a legend entry. joined: with a line. ringed: the
    points of these numbers are marked."""

    name: str
    look: int
    points: tuple[Point, ...]
    faint: bool = False
    joined: bool = True
    ringed: tuple[int, ...] = ()


@dataclass(frozen=True)
class Band:
    """A grey band from low to high: what the seeds of one method do."""

    name: str
    low: float
    high: float


@dataclass(frozen=True)
class Chart:
    """name: of its files. y_zero: draw a line at 0. reverse_x: larger values to the left.
    dodge: shift the series sideways a little, where they share their x. min_span: that the y axis
    shows at least."""

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
    band: Band | None = None


def csv_rows(chart: Chart) -> list[dict[str, object]]:
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
