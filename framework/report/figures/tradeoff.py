"""Speed against accuracy: what every method and budget costs, and which of them are worth it.

A configuration is a method with its budget. It lies on the Pareto front of a scene if no other has
at least its mean PSNR at no more of the cost. As some may lack seeds, all are measured by what they
have over the one with the most, over the seeds of both. It is *worth its cost* if it is the
cheapest of the front, or really better than the last cheaper one that is: the paired t test,
corrected for all others there. Seconds are those of the training alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from framework.report.parts.chart import MIN_SPAN_DB, Band, Chart, Point, Series
from framework.report.parts.palette import LIGHT, looks
from framework.report.statistics.compare import Comparison, compare
from framework.report.statistics.estimates import Spread, spread
from framework.report.statistics.numbers import average
from framework.report.statistics.outcomes import by_pair
from framework.report.study.runs import ReportRun, Study

SAME_COST = 0.02  # costs that differ by less than this share are not worth a chart
MOST_PANELS = 6  # charts of methods below each other in one figure
LOG_FROM = 4  # ratio of costs from which an axis is logarithmic; a lesser one has too few ticks


@dataclass(frozen=True)
class Entry:
    """A method with a budget on one scene: means over its runs. train_s: by the wall clock, or of
    CPU time where other programs disturbed the study. gain: what it is ranked by, PSNR `above` the
    entry of the scene with the most seeds."""

    method: str
    family: str
    budget: str
    psnr: Spread
    train_s: float
    gaussians: float
    megabytes: float
    runs: tuple[ReportRun, ...]
    gain: float = 0.0


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
    most = max(found, key=lambda entry: entry.psnr.n, default=None)
    return [replace(entry, gain=above(entry, most)) for entry in found] if most else []


def _pairs(one: Entry, other: Entry) -> Comparison | None:
    return compare(one.method, by_pair(one.runs), other.method, by_pair(other.runs))


def above(one: Entry, other: Entry) -> float:
    """What `one` has over `other` in dB, in the seeds of both; of their means where none is."""
    found = _pairs(one, other)
    return one.psnr.mean - other.psnr.mean if found is None else found.difference


def better(one: Entry, other: Entry, tests: int) -> bool:
    """Whether the paired test, corrected for so many, tells that `one` is above `other`."""
    found = _pairs(one, other)
    return found is not None and found.difference > 0 and replace(found, tests=tests).significant


def front(found: Sequence[Entry], cost: Callable[[Entry], float]) -> list[int]:
    """Indices of the entries on the Pareto front, the cheapest first."""
    order = sorted(range(len(found)), key=lambda k: (cost(found[k]), -found[k].gain))
    best, kept = -np.inf, []
    for k in order:
        if found[k].gain > best:
            best = found[k].gain
            kept.append(k)
    return kept


def worth(found: Sequence[Entry], cost: Callable[[Entry], float]) -> list[int]:
    """Indices of those worth their cost, the cheapest first; none where nothing can be tested.
    Corrected for all the others: it is the data that tells who stands on the front."""
    on_front = front(found, cost)
    kept = on_front[:1]
    if not kept or found[kept[0]].psnr.n < 2:
        return []
    for k in on_front[1:]:
        if better(found[k], found[kept[-1]], len(found) - 1):
            kept.append(k)
    return kept


def charts(study: Study, scene: str) -> list[tuple[Chart, ...]]:
    """PSNR against seconds; against Gaussians and file size where these differ."""
    found = entries(study, scene)
    if len(found) < 2:
        return []
    label = f"training time (s, {'CPU' if study.by_cpu else 'wall clock'})"
    panels = _panels(found, scene)
    time = [
        _chart(study, found, p, study.file_of("tradeoff", scene), label, train_s) for p in panels
    ]
    sizes = [
        _chart(study, found, panel, study.file_of("size", scene), label, cost)
        for label, cost in (("Gaussians", _gaussians), ("file size (MB)", megabytes))
        if differs([cost(entry) for entry in found])
        for panel in panels
    ]
    return [tuple(time), *([tuple(sizes)] if sizes else [])]


def train_s(entry: Entry) -> float:
    """The cost in seconds."""
    return entry.train_s


def _gaussians(entry: Entry) -> float:
    return entry.gaussians


def megabytes(entry: Entry) -> float:
    """The cost in file size."""
    return entry.megabytes


def differs(costs: Sequence[float]) -> bool:
    """Whether costs are far enough apart for a chart."""
    return min(costs) > 0 and max(costs) > (1 + SAME_COST) * min(costs)


def _panels(found: Sequence[Entry], scene: str) -> list[tuple[str, dict[int, str]]]:
    """(title, series of the entries in it by their index) of every chart. A series per method and
    capacity where the colours suffice; else a chart per method, its capacities as series; where
    methods or capacities are too many for that, a series per method."""
    names = {k: ", ".join(filter(None, (e.family, _capacity(e)))) for k, e in enumerate(found)}
    if len(set(names.values())) <= len(LIGHT):
        return [(scene, names)]
    families = {k: entry.family for k, entry in enumerate(found)}
    kinds = {k: _capacity(entry) or "capacity=fixed" for k, entry in enumerate(found)}
    several = 1 < len(set(kinds.values())) <= len(LIGHT)
    if not several or len(set(families.values())) > MOST_PANELS:
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
    """A series of `panel` goes through its undominated entries; dominated ones are faint; what is
    worth its cost among all that was found on the scene is ringed."""
    ringed_ones = set(worth(found, cost))
    title, shown = panel
    methods = set(shown.values()) <= set(study.families)
    order = study.families if methods else list(dict.fromkeys(shown.values()))
    series = []
    given = looks(order)
    for family in order:
        own = [k for k, name in shown.items() if name == family]
        best = [own[k] for k in front([found[k] for k in own], cost)]
        others = [k for k in own if k not in best]
        ringed = tuple(i for i, k in enumerate(best) if k in ringed_ones)
        points = tuple(_point(found[k], cost) for k in best)
        series.append(Series(family, given[family], points, joined=len(points) > 1, ringed=ringed))
        if others:
            faint = tuple(_point(found[k], cost) for k in others)
            series.append(Series(family, given[family], faint, faint=True, joined=False))
    costs = [cost(entry) for entry in found]
    log_x = 0 < LOG_FROM * min(costs) < max(costs)
    drawn = tuple(s for s in series if s.points)
    return Chart(
        name, title, x_label, "test PSNR (dB)", drawn, log_x, min_span=MIN_SPAN_DB,
        band=_band(study, found),
    )  # fmt: skip


def _band(study: Study, found: Sequence[Entry]) -> Band | None:
    """Where single runs of the baseline fall, which has one budget."""
    for entry in found:
        if entry.method == study.baseline and entry.psnr.sd is not None and not entry.budget:
            reach = 2 * entry.psnr.sd
            name = f"single runs of {entry.method} (mean ± 2 σ)"
            return Band(name, entry.psnr.mean - reach, entry.psnr.mean + reach)
    return None


def _capacity(entry: Entry) -> str:
    """How the number of Gaussians is decided, where that differs; its options are budgets."""
    return entry.runs[0].method_label.capacity.partition(",")[0]


def _point(entry: Entry, cost: Callable[[Entry], float]) -> Point:
    note = f"{entry.budget}, " if entry.budget else ""
    return Point(cost(entry), entry.psnr.mean, *entry.psnr.ends, f"{note}n = {entry.psnr.n}")
