"""Stress studies: PSNR and gain against the strength of a stress, and the break-down point of each
method.

A panel is a scene under one stress with at least `FEWEST_LEVELS` tested strengths, or two if some
run would be in no panel. Everything else that distinguishes it from others of its name is fixed.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from framework.report.statistics.breakdown import Breakdown, break_down, gains_of_levels
from framework.report.statistics.compare import Pairs, block
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import average
from framework.report.statistics.outcomes import by_pair
from framework.report.study.axes import STRESSES, Axis
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study, file_names
from framework.report.study.words import value_text

FEWEST_LEVELS = 3


@dataclass(frozen=True)
class Panel:
    """A scene along a stress.

    Attributes:
        title: the scene with its fixed conditions.
        levels: strengths, the weakest stress first.
        runs: by method and level.
        file: the name of its figure's files.
    """

    title: str
    axis: Axis
    levels: tuple[float, ...]
    runs: dict[Method, dict[float, list[ReportRun]]]
    file: str = ""

    @property
    def all_runs(self) -> list[ReportRun]:
        return [
            run for by_level in self.runs.values() for runs in by_level.values() for run in runs
        ]

    def means(self, method: Method) -> dict[float, float]:
        """Level -> mean PSNR in dB, where every run has one."""
        runs = self.runs.get(method, {})
        means = {v: average([run.mean("psnr") for run in runs.get(v, [])]) for v in self.levels}
        return {level: mean for level, mean in means.items() if mean is not None}


@dataclass(frozen=True)
class Limit:
    """Where a method stops helping on a panel.

    Attributes:
        levels: the strengths that were compared.
        gains: at each of them the mean gain in dB and its interval, corrected for all strengths,
            methods and panels.
        against: the baseline.
    """

    panel: Panel
    method: Method
    against: Method
    breakdown: Breakdown
    levels: tuple[float, ...]
    gains: tuple[tuple[float, Interval | None], ...]

    def levels_with(self, sign: int) -> list[float]:
        """The strengths with a significant gain (1), a significant loss (-1) or neither (0)."""
        return [v for v, s in zip(self.levels, self.breakdown.signs, strict=True) if s == sign]

    def largest(self, sign: int) -> tuple[float, float, Interval | None]:
        """The strength with the largest significant gain or loss, that gain and its interval."""
        cells = zip(self.levels, self.gains, self.breakdown.signs, strict=True)
        chosen = [(v, mean, inside) for v, (mean, inside), s in cells if s == sign]
        return max(chosen, key=lambda cell: sign * cell[1])


def panels(study: Study) -> list[Panel]:
    """The panels of a study of stresses; none if one of its tested runs is in no panel."""
    every = [p for axis in STRESSES for p in _panels_along(study, axis)]
    names = file_names(panel.title for panel in every)
    every = [replace(p, file=f"stress_{names[p.title]}_{p.axis.short}") for p in every]
    rich = [panel for panel in every if len(panel.levels) >= FEWEST_LEVELS]
    tested = {run.run.run_dir for run in study.runs if run.tested}
    for some in (rich, every):
        if tested <= {run.run.run_dir for panel in some for run in panel.all_runs}:
            return some
    return []


def limits(study: Study, shown: Sequence[Panel]) -> list[Limit]:
    """The break-down of every method but the baselines, on every panel with common levels."""
    cells = [
        (panel, method, gains)
        for panel in shown
        for method in panel.runs
        if (gains := _gains(study, panel, method)) is not None
    ]
    tests = sum(len(strengths) for _, _, (strengths, _) in cells)
    results = []
    for panel, method, (strengths, values) in cells:
        drawn = tuple(gains_of_levels(values, tests))
        broken = break_down(strengths, values, tests)
        levels = tuple(float(v) for v in strengths)
        results.append(Limit(panel, method, study.baseline_of(method), broken, levels, drawn))
    return results


def shown_scenes(study: Study, shown: Sequence[Panel]) -> list[str]:
    """The scenes to show in pictures: of a stress study, the ends of every panel."""
    ends = {
        run.scene
        for panel in shown
        for by_level in panel.runs.values()
        for level in (panel.levels[0], panel.levels[-1])
        for run in by_level.get(level, [])
    }
    along = {run.scene for panel in shown for run in panel.all_runs}
    return [scene for scene in study.scenes if scene in ends or scene not in along]


def _panels_along(study: Study, axis: Axis) -> list[Panel]:
    groups: dict[tuple[object, ...], list[ReportRun]] = defaultdict(list)
    for run in study.runs:
        if run.tested and run.level(axis) is not None:
            label = run.scene_label
            others = tuple((k, value_text(v)) for k, v in label.data.items() if k != axis.key)
            groups[label.without(axis.short), others].append(run)
    result = []
    for runs in groups.values():
        levels = {level for run in runs if (level := run.level(axis)) is not None}
        if len(levels) > 1:
            result.append(_panel(study, axis, runs, sorted(levels, key=lambda v: axis.harder * v)))
    return result


def _panel(study: Study, axis: Axis, runs: list[ReportRun], levels: list[float]) -> Panel:
    cells: dict[Method, dict[float, list[ReportRun]]] = {}
    for run in sorted(runs, key=lambda run: study.methods.index(run.method)):
        level = run.level(axis)
        if level is not None:
            cells.setdefault(run.method, {}).setdefault(level, []).append(run)
    return Panel(_title(study, axis, runs[0]), axis, tuple(levels), cells)


def _title(study: Study, axis: Axis, run: ReportRun) -> str:
    """The scene with the options that distinguish it, and those of its conditions that differ in
    the study."""
    label, named = run.scene_label, []
    for key, value in label.data.items():
        short = key.rpartition(".")[2]
        varies = len({value_text(r.scene_label.data.get(key)) for r in study.runs}) > 1
        if key != axis.key and varies and short not in dict(label.options):
            named.append(f"{short}={value_text(value)}")
    title = label.without(axis.short)
    return f"{title} ({', '.join(named)})" if named else title


def by_seed(values: Pairs) -> dict[int, float]:
    """Seed -> mean over its scenes, which are several if two labels have one strength, as
    `n_views=all` and the number of all."""
    by_place: dict[int, list[float]] = defaultdict(list)
    for (_, seed), value in values.items():
        by_place[seed].append(value)
    return {seed: float(np.mean(gain)) for seed, gain in by_place.items()}


def _gains(study: Study, panel: Panel, method: Method) -> tuple[np.ndarray, np.ndarray] | None:
    """Levels [L] and gains [L, n] over the baseline, for the seeds both have at all levels, or at
    those that `block` keeps."""
    base = study.baseline_of(method)
    if base == method or base not in panel.runs:
        return None
    result = []  # seed -> gain of every level
    for level in panel.levels:
        ours, others = (by_pair(panel.runs[m].get(level, [])) for m in (method, base))
        result.append(by_seed({key: ours[key] - others[key] for key in ours if key in others}))
    keys = [(k, seed) for k, values in enumerate(result) for seed in values]
    used, seeds = block(keys) if keys else ([], [])
    if len(used) < 2 or not seeds:
        return None
    gains = [[result[k][seed] for seed in seeds] for k in used]
    return np.array([panel.levels[k] for k in used]), np.array(gains)
