"""Stress studies: PSNR and the gain over the baseline against the strength of a stress, and where
each method stops helping.

A panel is a scene with all fixed that else tells it from others of its name, such as the draw of
its photos, along one stress with at least `FEWEST_LEVELS` tested strengths (two, where some run is
in no such panel).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from framework.report.parts.chart import MIN_SPAN_DB, Chart, Point, Series
from framework.report.parts.palette import looks
from framework.report.statistics.breakdown import Breakdown, break_down, gains_of_levels
from framework.report.statistics.compare import Pairs, block
from framework.report.statistics.estimates import Interval, spread
from framework.report.statistics.numbers import mean_text
from framework.report.statistics.outcomes import by_pair
from framework.report.study.axes import STRESSES, Axis
from framework.report.study.files import file_names
from framework.report.study.labels import text_of
from framework.report.study.runs import ReportRun, Study

FEWEST_LEVELS = 3


@dataclass(frozen=True)
class Panel:
    """title: the scene with its fixed conditions. levels: strengths, the weakest stress first.
    runs: by method and level. file: the name of its figure's files."""

    title: str
    axis: Axis
    levels: tuple[float, ...]
    runs: dict[str, dict[float, list[ReportRun]]]
    file: str = ""


@dataclass(frozen=True)
class Limit:
    """Where a method stops helping on a panel. levels: the strengths that were compared. ends:
    strength and mean gain (dB), of the weakest and of the strongest of them. gains: at every one
    the mean and the interval that is drawn there. against: the baseline, "" for the study's."""

    panel: Panel
    method: str
    found: Breakdown
    levels: tuple[float, ...]
    ends: tuple[tuple[float, float], tuple[float, float]]
    gains: tuple[tuple[float, Interval | None], ...] = ()
    against: str = ""


def panels(study: Study) -> list[Panel]:
    """The panels of a study of stresses; none where one of its tested runs is in no panel."""
    found, rich = _found(study)
    return next((some for some in (rich, found) if _holds(some, study)), [])


def panels_beside(study: Study) -> list[Panel]:
    """Those of a study that has other scenes too, which no stress is told of."""
    return [] if panels(study) else _found(study)[1]


def _found(study: Study) -> tuple[list[Panel], list[Panel]]:
    """All panels, and those with `FEWEST_LEVELS`."""
    every = [p for axis in STRESSES for p in _panels_along(study, axis)]
    names = file_names(panel.title for panel in every)
    found = [replace(p, file=f"stress_{names[p.title]}_{p.axis.short}") for p in every]
    return found, [panel for panel in found if len(panel.levels) >= FEWEST_LEVELS]


def _holds(some: Sequence[Panel], study: Study) -> bool:
    """Whether each tested run is in one of the panels."""
    shown = {
        run.run.run_dir
        for panel in some
        for by_level in panel.runs.values()
        for runs in by_level.values()
        for run in runs
    }
    return all(run.run.run_dir in shown for run in study.runs if run.tested)


def limits(study: Study, shown: Sequence[Panel]) -> list[Limit]:
    """The break-down of every method but the baselines, on every panel where levels are common.
    Their intervals hold for all strengths, methods and panels at once."""
    asked = [
        (panel, method, *gains)
        for panel in shown
        for method in panel.runs
        for gains in [_gains(study, panel, method)]
        if gains is not None
    ]
    tests = sum(len(strengths) for _, _, strengths, _ in asked)
    found = []
    for panel, method, strengths, values in asked:
        means = [(float(v), float(row.mean())) for v, row in zip(strengths, values, strict=True)]
        levels = tuple(level for level, _ in means)
        drawn = tuple(gains_of_levels(values, tests))
        broken = break_down(strengths, values, tests)
        base = study.baseline_of(method)
        against = "" if base == study.baseline else base
        found.append(Limit(panel, method, broken, levels, (means[0], means[-1]), drawn, against))
    return found


def compared_with(study: Study, found: Sequence[Limit]) -> str:
    """What the gains are over, in a title or on an axis."""
    several = any(limit.against for limit in found)
    return "the baseline of the same options" if several else study.baseline


def shown_scenes(study: Study, shown: Sequence[Panel]) -> list[str]:
    """The scenes to show in pictures: of a stress study, the ends of every panel."""
    if not shown:
        return study.scenes
    ends = {
        run.scene
        for panel in shown
        for by_level in panel.runs.values()
        for level in (panel.levels[0], panel.levels[-1])
        for run in by_level.get(level, [])
    }
    along = {r.scene for p in shown for by in p.runs.values() for rs in by.values() for r in rs}
    return [scene for scene in study.scenes if scene in ends or scene not in along]


def charts(study: Study, panel: Panel, found: Sequence[Limit]) -> tuple[Chart, ...]:
    """PSNR and gain against the strength, with 95 % intervals over seeds: those of the sentences.
    found: the `limits` of the study."""
    reverse = panel.axis.harder < 0
    order = looks(study.methods)
    level = [
        Series(m, order[m], _psnr_points(panel, by_level)) for m, by_level in panel.runs.items()
    ]
    gain = [
        Series(own.method, order[own.method], _gain_points(own))
        for own in found
        if own.panel is panel
    ]
    label = f"{panel.axis.label}; harder to the right"
    made = [
        Chart(
            panel.file,
            panel.title,
            label,
            "test PSNR (dB)",
            tuple(level),
            reverse_x=reverse,
            dodge=True,
            min_span=MIN_SPAN_DB,
        )
    ]
    if gain:
        y_label = f"gain over {compared_with(study, found)} (dB)"
        made.append(
            Chart(
                panel.file,
                "",
                label,
                y_label,
                tuple(gain),
                reverse_x=reverse,
                dodge=True,
                y_zero=True,
                min_span=MIN_SPAN_DB,
            )
        )
    return tuple(made)


def rows(panel: Panel) -> list[dict[str, str]]:
    """A row per method, a column per strength: mean PSNR in dB."""
    return [
        {"Method": method}
        | {
            f"{panel.axis.short} = {level:g}": mean_text(
                [run.mean("psnr") for run in by_level.get(level, [])], 2, show_half=True
            )
            for level in panel.levels
        }
        for method, by_level in panel.runs.items()
    ]


def _panels_along(study: Study, axis: Axis) -> list[Panel]:
    groups: dict[tuple[object, ...], list[ReportRun]] = defaultdict(list)
    for run in study.runs:
        if run.tested and run.level(axis) is not None:
            label = run.scene_label
            others = tuple((k, text_of(v)) for k, v in label.data.items() if k != axis.key)
            groups[label.without(axis.short), others].append(run)
    found = []
    for runs in groups.values():
        levels = {level for run in runs if (level := run.level(axis)) is not None}
        if len(levels) > 1:
            found.append(_panel(study, axis, runs, sorted(levels, key=lambda v: axis.harder * v)))
    return found


def _panel(study: Study, axis: Axis, runs: list[ReportRun], levels: list[float]) -> Panel:
    cells: dict[str, dict[float, list[ReportRun]]] = {}
    for method in study.methods:
        for run in runs:
            level = run.level(axis)
            if run.method == method and level is not None:
                cells.setdefault(method, {}).setdefault(level, []).append(run)
    return Panel(_title(study, axis, runs[0]), axis, tuple(levels), cells)


def _title(study: Study, axis: Axis, run: ReportRun) -> str:
    """The scene with what tells it from others of its name, and those of its conditions that
    differ in the study."""
    title, named = run.scene_label.without(axis.short), []
    for key, value in run.scene_label.data.items():
        short = key.rpartition(".")[2]
        varies = len({text_of(r.scene_label.data.get(key)) for r in study.runs}) > 1
        if key != axis.key and varies and f"{short}=" not in title:
            named.append(f"{short}={text_of(value)}")
    return f"{title} ({', '.join(named)})" if named else title


def _by_seed(values: Pairs) -> dict[int, float]:
    """Seed -> mean over its scenes, which are several where two labels have one strength, as
    `n_views=all` and the number of all."""
    found: dict[int, list[float]] = defaultdict(list)
    for (_, seed), value in values.items():
        found[seed].append(value)
    return {seed: float(np.mean(own)) for seed, own in found.items()}


def _differences(runs: Sequence[ReportRun], base: Sequence[ReportRun]) -> dict[int, float]:
    """Seed -> what `runs` have over `base`, of the scenes that both have with it."""
    own, others = by_pair(runs), by_pair(base)
    return _by_seed({key: own[key] - others[key] for key in own if key in others})


def _gains(study: Study, panel: Panel, method: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Levels [L] and gains [L, n] over the baseline, for the seeds both have at all levels, or at
    those that `block` keeps."""
    base = study.baseline_of(method)
    if base == method or base not in panel.runs:
        return None
    found = [
        _differences(panel.runs[method].get(v, []), panel.runs[base].get(v, []))
        for v in panel.levels
    ]
    keys = [(k, seed) for k, own in enumerate(found) for seed in own]
    used, seeds = block(keys) if keys else ([], [])
    if len(used) < 2 or not seeds:
        return None
    gains = [[found[k][seed] for seed in seeds] for k in used]
    return np.array([panel.levels[k] for k in used]), np.array(gains)


def _psnr_points(panel: Panel, by_level: dict[float, list[ReportRun]]) -> tuple[Point, ...]:
    found = {
        level: list(_by_seed(by_pair(by_level.get(level, []))).values()) for level in panel.levels
    }
    return tuple(point(level, values) for level, values in found.items() if values)


def _gain_points(limit: Limit) -> tuple[Point, ...]:
    points = []
    for level, (mean, interval) in zip(limit.levels, limit.gains, strict=True):
        low, high = (mean, mean) if interval is None else (interval.low, interval.high)
        points.append(Point(level, mean, low, high, f"n = {limit.found.n}"))
    return tuple(points)


def point(x: float, values: Sequence[float]) -> Point:
    """The mean of `values` with its 95 % interval, at `x`."""
    found = spread(values)
    return Point(x, found.mean, *found.ends, f"n = {found.n}")
