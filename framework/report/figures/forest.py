"""Forest plots: differences with their intervals below each other, zero marked.

A thick bar is an interval that holds for all comparisons of the report at once, a thin one belongs
to its row alone. A mark is filled where a thick bar excludes zero: a significant difference.
"""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from framework.report.figures.chart import STYLE, WIDTH, Marks, Picture, lay_out, save_figure
from framework.report.figures.palette import look_of, looks
from framework.report.statistics.compare import Comparison, excludes_zero
from framework.report.statistics.estimates import Interval
from framework.report.statistics.outcomes import Outcomes
from framework.report.study.scenes import marked
from framework.report.study.study import Study

MIN_SPAN_DB = 0.5
MOST_ROWS = 60  # with more, scenes are in the tables alone
ROW, MARGIN = 0.23, 0.95  # inches, of a row and of all else
LABEL_CHARACTERS, NAME_CHARACTERS = 24, 56


@dataclass(frozen=True)
class Row:
    """A difference.

    Attributes:
        method: the compared method.
        label: the scene or scenes.
        interval: None for a single run.
        joint: draw a thick bar.
        significant: fill the mark.
        method_index, scene_index: for the page's filter.
    """

    method: str
    label: str
    look: int
    middle: float
    interval: Interval | None
    joint: bool
    significant: bool
    method_index: int | None = None
    scene_index: int | None = None


@dataclass(frozen=True)
class Forest:
    """name: of its files. against: the baseline."""

    name: str
    against: str
    x_label: str
    rows: tuple[Row, ...]


def forest_picture(out_dir: Path, forest: Forest, alt: str) -> Picture:
    """Draw a forest plot into one file of each kind."""
    rows = [
        {
            "method": row.method,
            "against": forest.against,
            "on": row.label,
            "difference_db": row.middle,
            "low": row.interval and row.interval.low,
            "high": row.interval and row.interval.high,
            "interval": "all comparisons at once" if row.joint else "this row alone",
        }
        for row in forest.rows
    ]
    return save_figure(out_dir, forest.name, draw(forest), rows, alt)


def forest_of(study: Study, outcomes: Outcomes) -> Forest:
    """Every comparison of a study with its baseline, over all scenes and, if there are not too
    many, by scene."""
    of_scenes = sum(len(compared) for compared in outcomes.by_scene.values())
    detailed = 0 < of_scenes <= MOST_ROWS - 2 * len(outcomes.comparisons)
    rows: list[Row] = []
    for method, c in outcomes.comparisons.items():
        for scene in study.tested if detailed else []:
            alone = outcomes.by_scene[scene].get(method)
            if alone is not None:
                label, index = marked(scene, study.name_of(scene)), study.scenes.index(scene)
                rows.append(
                    replace(_row(study, alone, label, alone.interval, False), scene_index=index)
                )
        label = f"these {study.counted(c.scenes)}" if detailed else method.name
        rows.append(_row(study, c, label, c.joint or c.interval, c.joint is not None))
        if detailed and c.like is not None and c.like_joint is not None:
            row = _row(study, c, "scenes like these", c.like_joint, True)
            rows.append(replace(row, middle=c.like.mean, significant=c.general))
    bases = list(dict.fromkeys(c.baseline for c in outcomes.comparisons.values()))
    against = bases[0].name if len(bases) == 1 else "the baseline of the same budget"
    return Forest("differences", against, f"PSNR above {against} (dB)", tuple(rows))


def _row(study: Study, c: Comparison, label: str, interval: Interval | None, joint: bool) -> Row:
    families = [family.label for family in study.families]
    family = c.method.family.label
    return Row(
        c.method.name,
        label,
        looks(families)[family],
        c.difference,
        interval,
        joint,
        joint and excludes_zero(interval),
        families.index(family),
    )


def limits(rows: Sequence[Row]) -> tuple[float, float]:
    """Limits of the axis: zero and every thick bar are inside. A thin bar may be cut at three
    times the range of the thick ones.
    """

    def ends(some_rows: Sequence[Row]) -> list[float]:
        inside = [row.interval for row in some_rows if row.interval]
        middles = [row.middle for row in some_rows]
        return [0.0, *middles, *(end for i in inside for end in (i.low, i.high))]

    thick = ends([row for row in rows if row.joint] or rows)
    low, high = min(thick), max(thick)
    reach = max(high - low, MIN_SPAN_DB)
    low, high = max(min(ends(rows)), low - reach), min(max(ends(rows)), high + reach)
    missing = max(0.0, MIN_SPAN_DB - (high - low)) / 2
    pad = 0.04 * max(high - low, MIN_SPAN_DB)
    return low - missing - pad, high + missing + pad


def draw(forest: Forest) -> Figure:
    """The rows from top to bottom; a method's name stands above its rows."""
    with matplotlib.rc_context(STYLE):
        places, names = _places(forest)
        bottom = max([*places, *(at for at, _ in names)])
        figure = Figure(figsize=(WIDTH, ROW * (bottom + 1.5) + MARGIN), layout="constrained")
        axes = figure.subplots()
        marks = Marks()
        for row, at in zip(forest.rows, places, strict=True):
            _draw_row(axes, row, at, marks)
        axes.axvline(0, color="0.35", linewidth=1, zorder=0)
        for at, name in names:
            words = axes.annotate(
                textwrap.shorten(name, NAME_CHARACTERS, placeholder=" …"), (0, at), (4, 0),
                xycoords=("axes fraction", "data"), textcoords="offset points",
                va="center", weight="bold", parse_math=False,
            )  # fmt: skip
            words.set_in_layout(False)  # it lies inside the axes, however long
        labels = [_shortened(row.label) for row in forest.rows]
        axes.set_yticks(places, labels, parse_math=False)
        axes.set_ylim(bottom + 0.8, -0.8)
        axes.set_xlim(*limits(forest.rows))
        axes.set_xlabel(textwrap.fill(forest.x_label, NAME_CHARACTERS), parse_math=False)
        axes.grid(axis="x", alpha=0.3, linewidth=0.6)
        axes.tick_params(axis="y", length=0)
        lay_out(figure)
    return figure


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


def _draw_row(axes: Axes, row: Row, at: float, marks: Marks) -> None:
    look = look_of(row.look)
    artists = []
    if row.interval is not None:
        ends = [row.interval.low, row.interval.high]
        artists += axes.plot(
            ends, [at, at], color=look.color, linewidth=3.2 if row.joint else 1.0,
            solid_capstyle="butt", alpha=1 if row.joint else 0.75,
        )  # fmt: skip
    artists += axes.plot(
        [row.middle], [at], marker=look.marker, color=look.color, linestyle="none",
        markersize=8 if row.joint else 5, markeredgewidth=1.4,
        markerfacecolor=look.color if row.significant else "white",
    )  # fmt: skip
    marks.set(artists, row.method_index, row.scene_index)


def _shortened(label: str) -> str:
    text = textwrap.shorten(label, 2 * LABEL_CHARACTERS, placeholder=" …")
    return textwrap.fill(text, LABEL_CHARACTERS)
