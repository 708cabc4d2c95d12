"""Accuracy against training time for every method and budget.

A configuration is a method with its budget. It is on the Pareto front of a scene if no other one is
at least as good at no higher cost. Configurations may lack seeds, so they are ranked by their
difference to the configuration with the most seeds, over common seeds. A configuration is *worth
its cost* if it is the cheapest of the front, or significantly better than the last cheaper one that
is (paired t test, corrected for all others of the scene).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from framework.report.statistics.compare import Comparison, compare
from framework.report.statistics.estimates import Spread, spread
from framework.report.statistics.numbers import average
from framework.report.statistics.outcomes import by_pair
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study

SAME_COST = 0.02  # costs that differ by a smaller share count as equal
AS_GOOD_DB = 0.1  # a mean at most this far below the best counts as good
LIMITS_S = (15.0, 60.0, 300.0)


@dataclass(frozen=True, eq=False)
class Entry:
    """A configuration on one scene: means over its runs.

    Attributes:
        train_s: wall seconds, or CPU seconds if other programs disturbed the study.
        gain: PSNR `above` the entry of the scene with the most seeds; entries are ranked by it.
    """

    method: Method
    psnr: Spread
    train_s: float
    gaussians: float
    megabytes: float
    runs: tuple[ReportRun, ...]
    gain: float = 0.0

    @property
    def values(self) -> list[float | None]:
        """PSNR of the runs."""
        return [run.mean("psnr") for run in self.runs]

    @property
    def parameters(self) -> float:
        return float(np.mean([run.record.parameters for run in self.runs]))


def entries(study: Study, scene: str) -> list[Entry]:
    """The configurations of a scene with PSNR and training time in every run."""
    rows = []
    for method in study.methods:
        runs = study.of(scene, method)
        psnr = [value for run in runs if (value := run.mean("psnr")) is not None]
        seconds = average(
            [run.record.train_cpu_s if study.by_cpu else run.record.train_s for run in runs]
        )
        if not runs or len(psnr) < len(runs) or seconds is None:
            continue
        size = float(np.mean([run.record.ply_bytes for run in runs])) / 1e6
        count = float(np.mean([run.record.gaussians for run in runs]))
        rows.append(Entry(method, spread(psnr), seconds, count, size, (*runs,)))
    most = max(rows, key=lambda entry: entry.psnr.n, default=None)
    return [replace(entry, gain=above(entry, most)) for entry in rows] if most else []


def _pairs(one: Entry, other: Entry) -> Comparison | None:
    return compare(one.method, by_pair(one.runs), other.method, by_pair(other.runs))


def above(one: Entry, other: Entry) -> float:
    """The difference of `one` to `other` in dB, over the seeds of both; of their means without
    common seeds."""
    comparison = _pairs(one, other)
    return one.psnr.mean - other.psnr.mean if comparison is None else comparison.difference


def better(one: Entry, other: Entry, tests: int) -> bool:
    """Whether `one` is significantly better than `other`, corrected for so many tests."""
    comparison = _pairs(one, other)
    return (
        comparison is not None
        and comparison.difference > 0
        and replace(comparison, tests=tests).significant
    )


def front(options: Sequence[Entry], cost: Callable[[Entry], float]) -> list[int]:
    """Indices of the entries on the Pareto front, the cheapest first."""
    order = sorted(range(len(options)), key=lambda k: (cost(options[k]), -options[k].gain))
    best, kept = -np.inf, []
    for k in order:
        if options[k].gain > best:
            best = options[k].gain
            kept.append(k)
    return kept


def paying(options: Sequence[Entry], cost: Callable[[Entry], float]) -> list[int]:
    """Return the indices of the entries that are worth their time, the cheapest first.

    An entry is one if it is significantly better than all cheaper ones that are. Tests are
    corrected for all others, because the data decide which of them are on the front. Without any
    test the result is empty.
    """
    on_front = front(options, cost)
    kept = on_front[:1]
    if not kept or options[kept[0]].psnr.n < 2:
        return []
    for k in on_front[1:]:
        if better(options[k], options[kept[-1]], len(options) - 1):
            kept.append(k)
    return kept


def train_s(entry: Entry) -> float:
    return entry.train_s


def gaussians(entry: Entry) -> float:
    return entry.gaussians


def megabytes(entry: Entry) -> float:
    return entry.megabytes


def _gain(entry: Entry) -> float:
    return entry.gain


def differs(costs: Sequence[float]) -> bool:
    """Whether costs are far enough apart for a chart."""
    return min(costs) > 0 and max(costs) > (1 + SAME_COST) * min(costs)


def one_machine(study: Study, scene: str) -> bool:
    """Whether one kind of machine made all runs of a scene, so that their seconds compare."""
    return len({run.machine for run in study.of(scene)}) < 2


@dataclass(frozen=True)
class Choice:
    """Which configuration to take within a time: the times with this answer, the answer, and the
    quickest configuration of all, if none fits."""

    limits_s: tuple[float, ...]
    entry: Entry | None
    quickest: Entry


def choices(study: Study, scene: str) -> list[Choice]:
    """Which configuration to take at each of `LIMITS_S`, limits with the same answer together; none
    of a single configuration, or if runs of different machines do not compare."""
    candidates = entries(study, scene)
    if len(candidates) < 2 or not one_machine(study, scene):
        return []
    answers: dict[Entry | None, list[float]] = {}
    for limit in LIMITS_S:
        within = [entry for entry in candidates if entry.train_s <= limit]
        answers.setdefault(_best_within(study, within) if within else None, []).append(limit)
    quickest = min(candidates, key=train_s)
    return [Choice(tuple(limits), entry, quickest) for entry, limits in answers.items()]


def _best_within(study: Study, within: Sequence[Entry]) -> Entry:
    """The best of these, but the baseline unless another is significantly better; of its family the
    quickest that is nearly as good and not significantly worse."""
    tests = max(1, len(within) - 1)
    best = max(within, key=_gain)
    plain = [entry for entry in within if entry.method.family == study.families[0]]
    base = max(plain, key=_gain, default=None)
    if base is not None and any(entry.psnr.n > 1 for entry in within):
        best = max((e for e in within if better(e, base, tests)), key=_gain, default=base)
    family = [entry for entry in within if entry.method.family == best.method.family]
    return min(_as_good(best, family, tests), key=train_s)


def _as_good(best: Entry, options: Sequence[Entry], tests: int) -> list[Entry]:
    """Those at most `AS_GOOD_DB` below `best` and not significantly worse."""
    return [
        entry
        for entry in options
        if entry.gain >= best.gain - AS_GOOD_DB and not better(best, entry, tests)
    ]


@dataclass(frozen=True)
class Cheapest:
    """The configuration of the highest PSNR, and the cheapest ones that are as good.

    Attributes:
        quickest: of the least training time; None if the runs are of several machines.
        smallest: of the smallest file; None if sizes are unknown.
    """

    best: Entry
    quickest: Entry | None
    smallest: Entry | None


def cheapest(study: Study, scene: str) -> Cheapest | None:
    """The cheapest configurations that are nearly as good as the best and not significantly worse;
    None of a single configuration."""
    options = entries(study, scene)
    if len(options) < 2:
        return None
    best = max(options, key=_gain)
    as_good = _as_good(best, options, len(options) - 1)
    sized = all(entry.megabytes > 0 for entry in options)
    return Cheapest(
        best,
        min(as_good, key=train_s) if one_machine(study, scene) else None,
        min(as_good, key=megabytes) if sized else None,
    )
