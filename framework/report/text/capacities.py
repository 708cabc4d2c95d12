"""Ways to decide the number of Gaussians against each other, all else equal.

The other comparisons of a report are between methods with one capacity. Here each capacity is
compared with the first one, `fixed` if it ran, over runs paired by scene and seed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from framework.report.statistics.compare import Comparison, compare, corrected
from framework.report.statistics.numbers import ABSENT, interval_text, signed, significant
from framework.report.statistics.outcomes import by_pair
from framework.report.study.labels import MethodLabel, listed
from framework.report.study.runs import ReportRun, Study
from framework.report.text.comparisons import tested_cells
from framework.report.verdict.lead import amount, could_hide

FIXED = "capacity=fixed"  # has no name among methods


@dataclass(frozen=True)
class Contest:
    """A capacity against that of `comparison.baseline`. method: what both have in common.
    parameters, cpu: ratios of the sums over the paired runs; None where a run lacks its time, or
    what it is compared with has no Gaussian."""

    method: str
    capacity: str
    against: str
    comparison: Comparison
    parameters: float | None
    cpu: float | None


def contests(study: Study) -> list[Contest]:
    """Of every method that ran with several capacities; corrected for all of them together."""
    labels = {run.method: run.method_label for run in study.runs}
    by_method: dict[str, list[MethodLabel]] = {}
    for method in study.methods:
        by_method.setdefault(labels[method].without_capacity, []).append(labels[method])
    found: dict[str, Contest] = {}
    for first, *others in by_method.values():
        for label in others:
            contest = _contest(study, label, first)
            if contest is not None:
                found[label.full] = contest
    tested = corrected({method: contest.comparison for method, contest in found.items()})
    return [replace(contest, comparison=tested[method]) for method, contest in found.items()]


def sentences(found: Sequence[Contest]) -> list[str]:
    """Of contests of one method, for every capacity what it takes and what it gives."""
    return [f"{_bare(c.capacity)}: {_told(c)}." for c in found]


def in_verdict(found: Sequence[Contest]) -> str:
    """Of contests of one method, who is really different and who is not told apart; "" of none."""
    known = [c for c in found if c.comparison.joint is not None]
    if not known:
        return ""
    clear = sorted((c for c in known if c.comparison.significant), key=_difference)
    told = "; ".join(f"{_bare(c.capacity)} {amount(c.comparison)}" for c in clear) or "nobody"
    rest = [c for c in known if not c.comparison.significant]
    alike = [
        f"{_bare(c.capacity)} ({_size(c)})" for c in sorted(rest, key=_difference, reverse=True)
    ]
    hidden = could_hide(c.comparison.joint for c in rest)
    others = f" Not told apart from it: {'; '.join(alike)}.{hidden}" if alike else ""
    base = _bare(known[0].against)
    return f"How many Gaussians, compared with capacity {base}: really different: {told}.{others}"


def evidence(found: Sequence[Contest]) -> str:
    """` (5 seeds, ranges hold for all 10 comparisons at once)`; "" of single runs."""
    tested = [c.comparison for c in found if c.comparison.joint is not None]
    if not tested:
        return ""
    seeds = listed(sorted({c.n for c in tested}), "or")
    return f" ({seeds} seeds, ranges hold for all {tested[0].tests} comparisons at once)"


def _bare(capacity: str) -> str:
    """`evidence (criterion=laplace)` of `capacity=evidence, criterion=laplace`."""
    name, *options = capacity.removeprefix("capacity=").split(", ")
    return f"{name} ({', '.join(options)})" if options else name


def _difference(c: Contest) -> float:
    return c.comparison.difference


def rows(found: Sequence[Contest]) -> list[dict[str, str]]:
    """All figures of all contests."""
    return [
        {
            "Method": c.method,
            "Capacity": c.capacity,
            "Compared with": c.against,
            **tested_cells(c.comparison),
            "Parameters, times": ABSENT if c.parameters is None else significant(c.parameters),
            "CPU, times": ABSENT if c.cpu is None else significant(c.cpu),
        }
        for c in found
    ]


def _contest(study: Study, label: MethodLabel, first: MethodLabel) -> Contest | None:
    own, base = study.of(method=label.full), study.of(method=first.full)
    names = {run.scene: run.scene_label.name for run in own}
    comparison = compare(label.full, by_pair(own), first.full, by_pair(base), names)
    if comparison is None:
        return None
    keys = by_pair(own).keys() & by_pair(base).keys()
    mine, theirs = _paired(own, keys), _paired(base, keys)
    sizes = [sum(run.record.parameters for run in runs) for runs in (mine, theirs)]
    seconds = [_cpu(runs) for runs in (mine, theirs)]
    cpu = seconds[0] / seconds[1] if seconds[0] and seconds[1] else None
    return Contest(
        label.without_capacity,
        label.capacity or FIXED,
        first.capacity or FIXED,
        comparison,
        sizes[0] / sizes[1] if sizes[1] else None,
        cpu,
    )


def _paired(runs: Sequence[ReportRun], keys: set[tuple[str, int]]) -> list[ReportRun]:
    return [run for run in runs if (run.scene, run.seed) in keys]


def _cpu(runs: Sequence[ReportRun]) -> float | None:
    known = [run.record.train_cpu_s for run in runs]
    return None if None in known else sum(value or 0.0 for value in known)


def _size(c: Contest) -> str:
    if c.parameters is None:
        return "a model where the other has none"
    return f"{significant(c.parameters)} times the parameters"


def _told(c: Contest) -> str:
    size = _size(c)
    time = "" if c.cpu is None else f", {significant(c.cpu)} times the CPU time"
    found = c.comparison
    change = f"{signed(found.difference)} dB"
    if found.joint is None:
        return f"{size}{time}, {change} in a single run, which says nothing of chance"
    claim = "" if found.significant else ", not told apart"
    return f"{size}{time}, {change} ({interval_text(found.joint)}{claim})"
