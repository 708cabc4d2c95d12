"""The charts of a report: PSNR over training time, against cost, and along a stress."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from framework.options import members_of
from framework.report.costs import Entry, differs, entries, front, gaussians, megabytes, paying
from framework.report.costs import train_s as seconds_of
from framework.report.figures.chart import (
    MIN_SPAN_DB,
    Chart,
    Picture,
    Point,
    Series,
    chart_picture,
)
from framework.report.figures.palette import looks
from framework.report.figures.views import shown_methods
from framework.report.statistics.estimates import estimate
from framework.report.statistics.outcomes import by_pair
from framework.report.stress import Limit, Panel, by_seed
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study

THIN_SEEDS = 12
LOG_FROM = 4  # ratio of costs from which an axis is logarithmic; a smaller one has too few ticks
TIME_LABEL = "training time (s, wall clock, without evaluation)"
PSNR_LABEL = "test PSNR (dB)"
Evaluations = dict[int, tuple[float, float]]  # step -> seconds, test PSNR (dB)


def evaluations(run: ReportRun) -> Evaluations:
    """Return the evaluations of a run during training."""
    history = run.run.history.numbers
    rows = zip(history["step"], history["seconds"], history["test_psnr"], strict=True)
    return {int(step): (float(s), float(psnr)) for step, s, psnr in rows if not math.isnan(psnr)}


def has_members(study: Study, scene: str) -> bool:
    """Whether a run of the scene joins several trainings, whose curves follow each other."""
    records = [run.record for run in study.of(scene)]
    cases = [(r.config["trainer"], len(r.scene.training) if r.scene else 1) for r in records]
    return any(members_of(t.get("members", 1), t["steps"], views) > 1 for t, views in cases)


def curves(study: Study, scene: str) -> Picture | None:
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
    chart = Chart(name, scene, TIME_LABEL, PSNR_LABEL, tuple(series), min_span=MIN_SPAN_DB)
    return chart_picture(study.out_dir, (chart,), f"Quality over training time of {scene}")


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
    spreads = estimate([psnr for _, psnr in pairs])
    seconds = sum(second for second, _ in pairs) / len(pairs)
    return Point(seconds, spreads.mean, *spreads.ends, f"step {step}")


def cost_charts(study: Study, scene: str) -> list[tuple[Chart, ...]]:
    """PSNR against seconds; against Gaussians and file size where these differ."""
    options = entries(study, scene)
    if len(options) < 2:
        return []
    label = f"training time (s, {'CPU' if study.by_cpu else 'wall clock'})"
    name = study.file_of("tradeoff", scene)
    time = _cost_chart(study, options, scene, name, label, seconds_of)
    name = study.file_of("size", scene)
    sizes = tuple(
        _cost_chart(study, options, scene, name, label, cost)
        for label, cost in (("Gaussians", gaussians), ("file size (MB)", megabytes))
        if differs([cost(entry) for entry in options])
    )
    return [(time,), *([sizes] if sizes else [])]


def _cost_chart(
    study: Study,
    options: Sequence[Entry],
    title: str,
    name: str,
    x_label: str,
    cost: Callable[[Entry], float],
) -> Chart:
    """A series for each method and capacity connects its undominated entries; dominated ones are
    faint. Entries that are worth their time among all of the scene are ringed.
    """
    ringed = set(paying(options, cost))
    kinds = [_without_limits(entry.method) for entry in options]
    numbers = looks(kind.label for kind in kinds)
    series = []
    for kind in dict.fromkeys(kinds):
        indices = [k for k, of in enumerate(kinds) if of == kind]
        best = [indices[k] for k in front([options[k] for k in indices], cost)]
        look, index = numbers[kind.label], study.families.index(kind.family)
        rings = tuple(i for i, k in enumerate(best) if k in ringed)
        points = tuple(_cost_point(options[k], cost) for k in best)
        series.append(Series(kind.name, look, points, index, joined=len(points) > 1, ringed=rings))
        rest = tuple(_cost_point(options[k], cost) for k in indices if k not in best)
        if rest:
            series.append(Series(kind.name, look, rest, index, faint=True, joined=False))
    costs = [cost(entry) for entry in options]
    log_x = 0 < LOG_FROM * min(costs) < max(costs)
    return Chart(name, title, x_label, PSNR_LABEL, tuple(series), log_x, min_span=MIN_SPAN_DB)


def _without_limits(method: Method) -> Method:
    """The method with its capacity alone, whose options are budgets."""
    return replace(method.family, capacity=method.capacity[:1])


def _cost_point(entry: Entry, cost: Callable[[Entry], float]) -> Point:
    budget = "".join(f"{key}={value}, " for key, value in entry.method.budget)
    note = f"{budget}n = {entry.psnr.n}"
    return Point(cost(entry), entry.psnr.mean, *entry.psnr.ends, note)


def stress_charts(
    study: Study, panel: Panel, limits: Sequence[Limit], against: str
) -> tuple[Chart, ...]:
    """PSNR and gain against the strength with 95 % intervals over seeds."""
    numbers = looks(method.label for method in study.methods)

    def series(method: Method, points: Sequence[Point]) -> Series:
        index = study.families.index(method.family)
        return Series(method.name, numbers[method.label], tuple(points), index)

    def chart(title: str, y_label: str, lines: Sequence[Series], zero: bool) -> Chart:
        return Chart(
            *(panel.file, title, f"{panel.axis.label}; harder to the right", y_label, tuple(lines)),
            reverse_x=panel.axis.harder < 0,
            dodge=True,
            y_zero=zero,
            min_span=MIN_SPAN_DB,
        )

    psnr = [
        series(method, _points({v: by_level.get(v, []) for v in panel.levels}))
        for method, by_level in panel.runs.items()
    ]
    gain = [series(limit.method, _gain_points(limit)) for limit in limits if limit.panel is panel]
    charts = [chart(panel.title, PSNR_LABEL, psnr, False)]
    if gain:
        charts.append(chart("", f"gain over {against} (dB)", gain, True))
    return tuple(charts)


def _points(runs: dict[float, list[ReportRun]]) -> list[Point]:
    """The mean over the seeds of each level with its 95 % interval."""
    values = {level: list(by_seed(by_pair(of_level)).values()) for level, of_level in runs.items()}
    spreads = {level: estimate(of_level) for level, of_level in values.items() if of_level}
    return [Point(x, s.mean, *s.ends, f"n = {s.n}") for x, s in spreads.items()]


def _gain_points(limit: Limit) -> list[Point]:
    points = []
    for level, (mean, interval) in zip(limit.levels, limit.gains, strict=True):
        low, high = (mean, mean) if interval is None else (interval.low, interval.high)
        points.append(Point(level, mean, low, high, f"n = {limit.breakdown.n}"))
    return points
