"""Speed against accuracy: what every method and budget costs, which of them no other beats, and
which one to take for a given time.

A configuration is a method with its budget. It lies on the Pareto front of a scene if no other has
at least its mean PSNR at no more of the cost. Seconds are those of the training alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from framework.report.parts.chart import Chart, Point, Series
from framework.report.parts.palette import LIGHT
from framework.report.statistics.estimates import Spread, compare, spread
from framework.report.statistics.numbers import average, mean_text, p_text
from framework.report.statistics.outcomes import by_pair
from framework.report.study.collect import ReportRun, Study
from framework.report.study.labels import listed, slug

LIMITS_S = (15.0, 60.0, 300.0)
SAME_COST = 0.02  # costs that differ by less than this share are not worth a chart
SIGNIFICANCE = 0.05
LOG_FROM = 4  # ratio of costs from which an axis is logarithmic; a lesser one has too few ticks
AS_GOOD_DB = 0.1  # a model so much worse than the best counts as good


@dataclass(frozen=True)
class Entry:
    """A method with a budget on one scene: means over its runs. train_s: by the wall clock, or of
    CPU time where other programs disturbed the study."""

    method: str
    family: str
    budget: str
    psnr: Spread
    train_s: float
    gaussians: float
    megabytes: float
    runs: tuple[ReportRun, ...]


def entries(study: Study, scene: str) -> list[Entry]:
    """What was measured on a scene, for methods with PSNR and training time in every run."""
    found = []
    for method in study.methods:
        runs = study.of(scene, method)
        psnr = [value for run in runs if (value := run.mean("psnr")) is not None]
        seconds = average(
            [run.record.train_cpu_s if study.by_cpu else run.record.train_s for run in runs]
        )
        if not runs or len(psnr) < len(runs) or seconds is None:
            continue
        label = runs[0].method_label
        size = float(np.mean([run.record.ply_bytes for run in runs])) / 1e6
        count = float(np.mean([run.record.gaussians for run in runs]))
        found.append(
            Entry(method, label.family, label.budget, spread(psnr), seconds, count, size, (*runs,))
        )
    return found


def front(found: Sequence[Entry], cost: Callable[[Entry], float]) -> list[int]:
    """Indices of the entries on the Pareto front, the cheapest first."""
    order = sorted(range(len(found)), key=lambda k: (cost(found[k]), -found[k].psnr.mean))
    best, kept = -np.inf, []
    for k in order:
        if found[k].psnr.mean > best:
            best = found[k].psnr.mean
            kept.append(k)
    return kept


def charts(study: Study, scene: str) -> list[tuple[Chart, ...]]:
    """PSNR against seconds; against Gaussians and file size where these differ."""
    found = entries(study, scene)
    if len(found) < 2:
        return []
    name = slug(scene)
    label = f"training time (s, {'CPU' if study.by_cpu else 'wall clock'})"
    panels = _panels(found, scene)
    time = [_chart(study, found, p, f"tradeoff_{name}", label, _time) for p in panels]
    sizes = [
        _chart(study, found, panel, f"size_{name}", label, cost)
        for label, cost in (("Gaussians", _gaussians), ("file size (MB)", _size))
        if _differs([cost(entry) for entry in found])
        for panel in panels
    ]
    return [tuple(time), *([tuple(sizes)] if sizes else [])]


def advice(study: Study, scene: str) -> list[str]:
    """Which configuration to take at each of `LIMITS_S`, a sentence each; limits
    with the same answer share it."""
    found = entries(study, scene)
    if len(found) < 2:
        return []
    limits: dict[str, list[str]] = {}
    for limit in LIMITS_S:
        limits.setdefault(_advice(found, limit), []).append(f"{limit:g}")
    of_cpu = " of CPU time" if study.by_cpu else ""
    return [f"Within {listed(told, 'or')} s{of_cpu}: {answer}" for answer, told in limits.items()]


def smallest(study: Study, scene: str) -> str | None:
    """Which configuration has the smallest model within `AS_GOOD_DB` of the best; None where all
    are of one size."""
    found = entries(study, scene)
    if len(found) < 2 or not _differs([_size(entry) for entry in found]):
        return None
    best = max(found, key=lambda entry: entry.psnr.mean)
    close = [entry for entry in found if entry.psnr.mean >= best.psnr.mean - AS_GOOD_DB]
    least = min(close, key=_size)
    text = f"The smallest model within {AS_GOOD_DB} dB of the best: {_told(least)}"
    return f"{text}, the best itself." if least is best else f"{text}; the best: {_told(best)}."


def _told(entry: Entry) -> str:
    """A configuration with its quality and size."""
    level = mean_text([run.mean("psnr") for run in entry.runs], 2, show_half=True)
    parameters = np.mean([run.record.parameters for run in entry.runs]) / 1000
    return (
        f"{entry.method}, {level} dB with {entry.gaussians:,.0f} Gaussians ({parameters:,.0f} k"
        f" parameters, {1000 * entry.megabytes:,.0f} kB)"
    )


def rows(study: Study, scene: str) -> list[dict[str, str]]:
    """The cost of every method."""
    pareto = {found[k].method for found in [entries(study, scene)] for k in front(found, _time)}
    return [
        {
            "Method": method,
            "PSNR (dB)": mean_text([run.mean("psnr") for run in runs], 2, show_half=True),
            "Train, wall (s)": mean_text([run.record.train_s for run in runs], 1),
            "Train, CPU (s)": mean_text([run.record.train_cpu_s for run in runs], 1),
            "Render (frames/s)": mean_text([_frames_per_s(run) for run in runs], 1),
            "Gaussians": mean_text([float(run.record.gaussians) for run in runs], 0),
            "Parameters (k)": mean_text([run.record.parameters / 1000 for run in runs], 0),
            "PLY (kB)": mean_text([run.record.ply_bytes / 1000 for run in runs], 0),
            "Pareto": "yes" if method in pareto else "",
        }
        for method in study.methods
        if (runs := study.of(scene, method))
    ]


def _time(entry: Entry) -> float:
    return entry.train_s


def _gaussians(entry: Entry) -> float:
    return entry.gaussians


def _size(entry: Entry) -> float:
    return entry.megabytes


def _frames_per_s(run: ReportRun) -> float | None:
    """Test views per second of rendering; None where no time was taken."""
    seconds = run.run.metrics.numbers["render_s"]
    return len(seconds) / float(seconds.sum()) if seconds.sum() > 0 else None


def _differs(costs: Sequence[float]) -> bool:
    return min(costs) > 0 and max(costs) > (1 + SAME_COST) * min(costs)


def _panels(found: Sequence[Entry], scene: str) -> list[tuple[str, dict[int, str]]]:
    """(title, series of the entries in it by their index) of every chart. A series per method and
    capacity where the colours suffice; else a chart per method, its capacities as series; where
    these are too many as well, a series per method."""
    names = {k: ", ".join(filter(None, (e.family, _capacity(e)))) for k, e in enumerate(found)}
    if len(set(names.values())) <= len(LIGHT):
        return [(scene, names)]
    families = {k: entry.family for k, entry in enumerate(found)}
    kinds = {k: _capacity(entry) or "capacity=fixed" for k, entry in enumerate(found)}
    if not 1 < len(set(kinds.values())) <= len(LIGHT):
        return [(scene, families)]
    return [
        (f"{scene}, {family}", {k: kinds[k] for k in kinds if families[k] == family})
        for family in dict.fromkeys(families.values())
    ]


def _chart(
    study: Study,
    found: Sequence[Entry],
    panel: tuple[str, dict[int, str]],
    name: str,
    x_label: str,
    cost: Callable[[Entry], float],
) -> Chart:
    """A series of `panel` goes through its undominated entries; dominated ones are faint; the front
    of all that was found on the scene is ringed."""
    on_front = set(front(found, cost))
    title, shown = panel
    methods = set(shown.values()) <= set(study.families)
    order = study.families if methods else list(dict.fromkeys(shown.values()))
    series = []
    for index, family in enumerate(order):
        own = [k for k, name in shown.items() if name == family]
        best = [own[k] for k in front([found[k] for k in own], cost)]
        others = [k for k in own if k not in best]
        ringed = tuple(i for i, k in enumerate(best) if k in on_front)
        points = tuple(_point(found[k], cost) for k in best)
        series.append(Series(family, index, points, joined=len(points) > 1, ringed=ringed))
        if others:
            faint = tuple(_point(found[k], cost) for k in others)
            series.append(Series(family, index, faint, faint=True, joined=False))
    costs = [cost(entry) for entry in found]
    log_x = 0 < LOG_FROM * min(costs) < max(costs)
    drawn = tuple(s for s in series if s.points)
    return Chart(name, title, x_label, "test PSNR (dB)", drawn, log_x)


def _capacity(entry: Entry) -> str:
    """How the number of Gaussians is decided, where that differs; its options are budgets."""
    return entry.runs[0].method_label.capacity.partition(",")[0]


def _point(entry: Entry, cost: Callable[[Entry], float]) -> Point:
    interval, mean = entry.psnr.mean_interval, entry.psnr.mean
    low, high = (interval.low, interval.high) if interval else (mean, mean)
    note = f"{entry.budget}, " if entry.budget else ""
    return Point(cost(entry), mean, low, high, f"{note}n = {entry.psnr.n}")


def _advice(found: Sequence[Entry], limit_s: float) -> str:
    within = [entry for entry in found if entry.train_s <= limit_s]
    if not within:
        quickest = min(found, key=_time)
        return (
            f"nothing tested fits; the quickest is {quickest.method} with {quickest.train_s:.0f} s."
        )
    best = max(within, key=lambda entry: entry.psnr.mean)
    level = mean_text([run.mean("psnr") for run in best.runs], 2, show_half=True)
    return f"{best.method}, {level} dB in {best.train_s:.1f} s; {_rival(best, within)}."


def _rival(best: Entry, within: Sequence[Entry]) -> str:
    """The quickest configuration that the paired test does not tell from the best one."""
    if best.psnr.n < 2:
        return "single runs, so the order may be chance"
    if len(within) == 1:
        return "nothing else fits"
    alike = [entry for entry in within if entry is not best and _alike(best, entry) is not None]
    quicker = [entry for entry in alike if entry.train_s < best.train_s]
    if not alike:
        return "every other choice within that time is significantly worse"
    if not quicker:
        others = "1 other, which is" if len(alike) == 1 else f"{len(alike)} others, which are"
        return f"no significant difference to {others} no quicker"
    quickest = min(quicker, key=_time)
    return (
        f"no significant difference to {quickest.method}"
        f" ({p_text(_alike(best, quickest) or 0)}, uncorrected), which takes"
        f" {quickest.train_s:.1f} s"
    )


def _alike(best: Entry, other: Entry) -> float | None:
    """p of the paired test if it does not tell them apart, else None; 1 without common seeds."""
    found = compare("", by_pair(best.runs), "", by_pair(other.runs))
    if found is None or found.p is None:
        return 1.0
    return found.p if found.p >= SIGNIFICANCE else None
