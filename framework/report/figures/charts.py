"""The charts of a report: PSNR over training time, against cost, and along a stress."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from framework.options import members_of
from framework.report.costs import Entry, differs, entries, front, gaussians, megabytes, paying
from framework.report.costs import train_s as seconds_of
from framework.report.figures.chart import MIN_SPAN_DB, Band, Chart, Point, Series
from framework.report.figures.palette import LIGHT, looks
from framework.report.figures.views import shown_methods
from framework.report.statistics.estimates import spread
from framework.report.statistics.outcomes import by_pair
from framework.report.stress import Limit, Panel, by_seed
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study

THIN_SEEDS = 12
MOST_PANELS = 6  # charts of methods below each other in one figure
LOG_FROM = 4  # ratio of costs from which an axis is logarithmic; a smaller one has too few ticks
SAME_SIZE = 0.02  # model sizes that differ by a smaller share count as equal
TIME_LABEL = "training time (s, wall clock, without evaluation)"
PSNR_LABEL = "test PSNR (dB)"
FIXED = "capacity=fixed"
Evaluations = dict[int, tuple[float, float]]  # step -> seconds, test PSNR (dB)


def evaluations(run: ReportRun) -> Evaluations:
    """Return the evaluations of a run during training."""
    history = run.run.history.numbers
    rows = zip(history["step"], history["seconds"], history["test_psnr"], strict=True)
    return {int(step): (float(s), float(psnr)) for step, s, psnr in rows if not math.isnan(psnr)}


def has_members(study: Study, scene: str) -> bool:
    """Whether a run of the scene joins several trainings, whose curves follow each other."""
    for run in study.of(scene):
        trainer, info = run.record.config["trainer"], run.record.scene
        views = len(info.training) if info else 1
        if members_of(trainer.get("members", 1), trainer["steps"], views) > 1:
            return True
    return False


def curves(study: Study, scene: str) -> Chart | None:
    """Test PSNR over training time; None if no history of the scene has an evaluation."""
    series: list[Series] = []
    numbers = looks(family.label for family in study.families)
    for method in shown_methods(study, scene):
        runs = [points for run in study.of(scene, method) if (points := evaluations(run))]
        if runs:
            index = study.families.index(method.family)
            series += _courses(method.name, numbers[method.family.label], index, runs)
    if not series:
        return None
    name = study.file_of("curves", scene)
    return Chart(name, scene, TIME_LABEL, PSNR_LABEL, tuple(series), min_span=MIN_SPAN_DB)


def _courses(name: str, look: int, index: int, runs: Sequence[Evaluations]) -> list[Series]:
    thin = []
    if len(runs) > 1:
        for run in runs[:THIN_SEEDS]:
            points = tuple(Point(x, y, y, y) for x, y in run.values())
            thin.append(Series(name, look, points, index, faint=True))
    # a mean over fewer seeds at some steps would bend the curve
    steps = sorted(set(runs[0]).intersection(*runs))
    mean = tuple(_mean_point(step, [run[step] for run in runs]) for step in steps)
    return [*thin, Series(f"{name} (n = {len(runs)})", look, mean, index)] if mean else thin


def _mean_point(step: int, pairs: Sequence[tuple[float, float]]) -> Point:
    spreads = spread([psnr for _, psnr in pairs])
    seconds = sum(second for second, _ in pairs) / len(pairs)
    return Point(seconds, spreads.mean, *spreads.ends, f"step {step}")


def pair_curves(runs: Sequence[ReportRun]) -> Chart | None:
    """Test PSNR over training time of single runs."""
    numbers = looks(run.method.label for run in runs)
    series = tuple(
        Series(
            run.method.name,
            numbers[run.method.label],
            tuple(Point(x, y, y, y, f"step {step}") for step, (x, y) in evaluations(run).items()),
        )
        for run in runs
        if evaluations(run)
    )
    if not series:
        return None
    return Chart("curves", "", TIME_LABEL, PSNR_LABEL, series, min_span=MIN_SPAN_DB)


def cost_charts(study: Study, scene: str) -> list[tuple[Chart, ...]]:
    """PSNR against seconds; against Gaussians and file size where these differ."""
    options = entries(study, scene)
    if len(options) < 2:
        return []
    label = f"training time (s, {'CPU' if study.by_cpu else 'wall clock'})"
    panels = _panels(options, scene)
    name = study.file_of("tradeoff", scene)
    time = [_cost_chart(study, options, p, name, label, seconds_of) for p in panels]
    name = study.file_of("size", scene)
    sizes = [
        _cost_chart(study, options, panel, name, label, cost)
        for label, cost in (("Gaussians", gaussians), ("file size (MB)", megabytes))
        if differs([cost(entry) for entry in options])
        for panel in panels
    ]
    return [tuple(time), *([tuple(sizes)] if sizes else [])]


def _capacity(method: Method) -> str:
    """The capacity plugin, where it differs; its options are budgets."""
    return "=".join(method.capacity[0]) if method.capacity else ""


def _panels(options: Sequence[Entry], scene: str) -> list[tuple[str, dict[int, str]]]:
    """Return (title, names of the series by the index of their entries) of every chart.

    If there are enough colours, it is one chart with a series per method and capacity. Otherwise it
    is a chart per method, with its capacities as series. If methods or capacities are too many for
    that, it is a series per method.
    """
    families = {k: entry.method.family.name for k, entry in enumerate(options)}
    kinds = {k: _capacity(entry.method) for k, entry in enumerate(options)}
    names = {k: ", ".join(filter(None, (families[k], kinds[k]))) for k in families}
    if len(set(names.values())) <= len(LIGHT):
        return [(scene, names)]
    kinds = {k: kind or FIXED for k, kind in kinds.items()}
    several = 1 < len(set(kinds.values())) <= len(LIGHT)
    if not several or len(set(families.values())) > MOST_PANELS:
        return [(scene, families)]
    return [
        (f"{scene}, {family}", {k: kinds[k] for k in kinds if families[k] == family})
        for family in dict.fromkeys(families.values())
    ]


def _cost_chart(
    study: Study,
    options: Sequence[Entry],
    panel: tuple[str, dict[int, str]],
    name: str,
    x_label: str,
    cost: Callable[[Entry], float],
) -> Chart:
    """A series of `panel` connects its undominated entries; dominated ones are faint. Entries
    that are worth their time among all of the scene are ringed.
    """
    ringed = set(paying(options, cost))
    title, shown = panel
    families = {family.name: family for family in study.families}
    whole = set(shown.values()) <= set(families)
    order = list(families) if whole else list(dict.fromkeys(shown.values()))
    numbers = looks(families[label].label if label in families else label for label in order)
    series = []
    for label in order:
        indices = [k for k, of in shown.items() if of == label]
        best = [indices[k] for k in front([options[k] for k in indices], cost)]
        look = numbers[families[label].label if label in families else label]
        index = study.families.index(families[label]) if label in families else None
        rings = tuple(i for i, k in enumerate(best) if k in ringed)
        points = tuple(_cost_point(options[k], cost) for k in best)
        series.append(Series(label, look, points, index, joined=len(points) > 1, ringed=rings))
        rest = tuple(_cost_point(options[k], cost) for k in indices if k not in best)
        if rest:
            series.append(Series(label, look, rest, index, faint=True, joined=False))
    costs = [cost(entry) for entry in options]
    log_x = 0 < LOG_FROM * min(costs) < max(costs)
    drawn = tuple(s for s in series if s.points)
    return Chart(
        name, title, x_label, PSNR_LABEL, drawn, log_x, min_span=MIN_SPAN_DB,
        band=_band(study, options),
    )  # fmt: skip


def _band(study: Study, options: Sequence[Entry]) -> Band | None:
    """The range of single runs of the baseline, if it has one budget."""
    for entry in options:
        method, sd = entry.method, entry.psnr.sd
        if method == study.baseline and sd is not None and not method.budget:
            name = f"single runs of {method} (mean ± 2 σ)"
            return Band(name, entry.psnr.mean - 2 * sd, entry.psnr.mean + 2 * sd)
    return None


def _cost_point(entry: Entry, cost: Callable[[Entry], float]) -> Point:
    budget = "".join(f"{key}={value}, " for key, value in entry.method.budget)
    note = f"{budget}n = {entry.psnr.n}"
    return Point(cost(entry), entry.psnr.mean, *entry.psnr.ends, note)


def stress_charts(
    study: Study, panel: Panel, limits: Sequence[Limit], against: str
) -> tuple[Chart, ...]:
    """PSNR and gain against the strength with 95 % intervals over seeds.

    A third chart shows the number of Gaussians where a capacity changes it.
    """
    numbers = looks(method.label for method in study.methods)

    def series(method: Method, points: Sequence[Point]) -> Series:
        index = study.families.index(method.family)
        return Series(method.name, numbers[method.label], tuple(points), index)

    def chart(title: str, y_label: str, lines: Sequence[Series], zero: bool, span: float) -> Chart:
        return Chart(
            *(panel.file, title, f"{panel.axis.label}; harder to the right", y_label, tuple(lines)),
            reverse_x=panel.axis.harder < 0,
            dodge=True,
            y_zero=zero,
            min_span=span,
        )

    levels = {
        method: {level: by_level.get(level, []) for level in panel.levels}
        for method, by_level in panel.runs.items()
    }
    psnr = [
        series(method, _points({v: [*by_seed(by_pair(r)).values()] for v, r in by_level.items()}))
        for method, by_level in levels.items()
    ]
    gain = [series(limit.method, _gain_points(limit)) for limit in limits if limit.panel is panel]
    charts = [chart(panel.title, PSNR_LABEL, psnr, False, MIN_SPAN_DB)]
    if gain:
        charts.append(chart("", f"gain over {against} (dB)", gain, True, MIN_SPAN_DB))
    counts = {
        method: {v: [float(run.record.gaussians) for run in r] for v, r in by_level.items() if r}
        for method, by_level in levels.items()
    }
    if _grows(panel, counts):
        sizes = [series(method, _points(by_level)) for method, by_level in counts.items()]
        charts.append(chart("", "Gaussians", sizes, False, 0.0))
    return tuple(charts)


def _grows(panel: Panel, counts: dict[Method, dict[float, list[float]]]) -> bool:
    """Whether the size of a model changes along the stress, and not as its start alone."""
    means = [[float(np.mean(n)) for n in by_level.values()] for by_level in counts.values()]
    changes = any(max(means_of) > (1 + SAME_SIZE) * min(means_of) for means_of in means)
    return changes and any(r.record.methods.get("capacity") != "fixed" for r in panel.all_runs)


def _points(values: dict[float, list[float]]) -> list[Point]:
    """The mean of each level's values with its 95 % interval."""
    spreads = {
        level: spread(level_values) for level, level_values in values.items() if level_values
    }
    return [Point(x, s.mean, *s.ends, f"n = {s.n}") for x, s in spreads.items()]


def _gain_points(limit: Limit) -> list[Point]:
    points = []
    for level, (mean, interval) in zip(limit.levels, limit.gains, strict=True):
        low, high = (mean, mean) if interval is None else (interval.low, interval.high)
        points.append(Point(level, mean, low, high, f"n = {limit.breakdown.n}"))
    return points
