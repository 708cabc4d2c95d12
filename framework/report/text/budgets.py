"""What a configuration costs, in words and rows: which one to take for a given time, which one for
its size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from framework.report.figures.tradeoff import (
    Entry,
    above,
    better,
    differs,
    entries,
    megabytes,
    train_s,
    worth,
)
from framework.report.statistics.numbers import mean_text
from framework.report.study.labels import listed
from framework.report.study.runs import ReportRun, Study
from framework.report.verdict.lead import AS_GOOD_DB, comparable, one_machine

LIMITS_S = (15.0, 60.0, 300.0)
PAYS = "More time pays"


def advice(study: Study, scene: str) -> list[str]:
    """Which configuration to take at each of `LIMITS_S`, a sentence each; limits
    with the same answer share it."""
    found = entries(study, scene)
    if len(found) < 2 or not one_machine(study, scene):
        return []
    limits: dict[str, list[str]] = {}
    for limit in LIMITS_S:
        limits.setdefault(_advice(study, found, limit), []).append(f"{limit:g}")
    of_cpu = " of CPU time" if study.by_cpu else ""
    return [f"Within {listed(told, 'or')} s{of_cpu}: {answer}" for answer, told in limits.items()]


def in_verdict(study: Study) -> str:
    """Which budget to take, as the end of the verdict's first sentence: by time on a single scene,
    else where to look."""
    if not any(run.method_label.limits for run in study.runs):  # none of steps and the like
        return ""
    if not comparable(study):
        return ""
    found = entries(study, study.tested[0]) if len(study.tested) == 1 else []
    own: dict[str, list[str]] = {}
    others: dict[str, list[str]] = {}
    for limit in LIMITS_S:
        best = _choice(study, found, limit)
        if best is not None:
            size = f"({best.train_s:.1f} s, {best.gaussians:,.0f} Gaussians)"
            if best.family == study.families[0]:
                own.setdefault(f"{best.budget} {size}", []).append(f"{limit:g}")
            else:
                others.setdefault(f"{best.method} {size}", []).append(f"{limit:g}")
    if len(own) == 1 and not others:
        return f" with {next(iter(own))}"
    told = [f"{budget} within {listed(some, 'or')} s" for budget, some in own.items()]
    rather = [f"within {listed(some, 'or')} s rather {name}" for name, some in others.items()]
    text = f" with {'; '.join(told)}" if told else ""
    return "; ".join([text, *rather]) or " at the budget that suits you (below)"


def _choice(study: Study, found: Sequence[Entry], limit_s: float) -> Entry | None:
    """The best within a time, of the baseline unless another is really better than it; rather the
    quickest of its family that is nearly as good and not told apart from it."""
    within = [entry for entry in found if entry.train_s <= limit_s]
    if not within:
        return None
    tests = max(1, len(within) - 1)
    best = max(within, key=_gain)
    plain = max((e for e in within if e.family == study.families[0]), key=_gain, default=None)
    if plain is not None and any(entry.psnr.n > 1 for entry in within):
        best = max((e for e in within if better(e, plain, tests)), key=_gain, default=plain)
    as_good = [
        entry
        for entry in within
        if entry.family == best.family
        and entry.gain >= best.gain - AS_GOOD_DB
        and not better(best, entry, tests)
    ]
    return min(as_good, key=train_s)


def _gain(entry: Entry) -> float:
    return entry.gain


def smallest(study: Study, scene: str) -> str | None:
    """Which configuration has the smallest model within `AS_GOOD_DB` of the best; None where all
    are of one size."""
    found = entries(study, scene)
    if len(found) < 2 or not differs([megabytes(entry) for entry in found]):
        return None
    best = max(found, key=_gain)
    close = [entry for entry in found if entry.gain >= best.gain - AS_GOOD_DB]
    least = min(close, key=megabytes)
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
    found = entries(study, scene)
    first, *others = [found[k].method for k in worth(found, train_s)] or [""]
    marks = {first: "cheapest", **dict.fromkeys(others, "yes")}
    return [
        {
            "Method": method,
            "PSNR (dB)": mean_text([run.mean("psnr") for run in runs], 2, show_half=True),
            "Train, wall (s)": mean_text([run.record.train_s for run in runs], 1),
            "Train, CPU (s)": mean_text([run.record.train_cpu_s for run in runs], 1),
            "Render (frames/s)": mean_text([_frames_per_s(run) for run in runs], 1),
            "Gaussians": mean_text([float(run.record.gaussians) for run in runs], 0),
            "Parameters (k)": mean_text([run.record.parameters / 1000 for run in runs], 0),
            "PLY (kB)": mean_text([run.record.ply_bytes / 1000 or None for run in runs], 0),
            PAYS: marks.get(method, "not shown"),
        }
        for method in study.methods
        if (runs := study.of(scene, method))
    ]


def _frames_per_s(run: ReportRun) -> float | None:
    """Test views per second of rendering; None where no time was taken."""
    seconds = run.run.metrics.numbers["render_s"]
    return len(seconds) / float(seconds.sum()) if seconds.sum() > 0 else None


def _advice(study: Study, found: Sequence[Entry], limit_s: float) -> str:
    within = [entry for entry in found if entry.train_s <= limit_s]
    best = _choice(study, found, limit_s)
    if best is None:
        quickest = min(found, key=train_s)
        return (
            f"nothing tested fits; the quickest is {quickest.method} with {quickest.train_s:.0f} s."
        )
    level = mean_text([run.mean("psnr") for run in best.runs], 2, show_half=True)
    return (
        f"{best.method}, {level} dB in {best.train_s:.1f} s with {best.gaussians:,.0f} Gaussians;"
        f" {_rival(best, within)}."
    )


def _rival(best: Entry, within: Sequence[Entry]) -> str:
    """What the paired test tells to be better than the best one, which may be a little worse than
    another; else the quickest that it does not tell from it."""
    if best.psnr.n < 2:
        return "single runs, so the order may be chance"
    if len(within) == 1:
        return "nothing else fits"
    others = [entry for entry in within if entry is not best]
    n = len(others)
    ahead = [entry for entry in others if better(entry, best, n)]
    if ahead:
        most = max(ahead, key=lambda entry: above(entry, best))
        return (
            f"{most.method} takes {most.train_s:.1f} s and is really better, by"
            f" {above(most, best):.2f} dB"
        )
    alike = [entry for entry in others if not better(best, entry, n)]
    quicker = [entry for entry in alike if entry.train_s < best.train_s]
    if not alike:
        return "every other choice within that time is really worse"
    if not quicker:
        rest = "1 other, which is" if len(alike) == 1 else f"{len(alike)} others, which are"
        return f"not told apart from {rest} no quicker"
    quickest = min(quicker, key=train_s)
    lower = above(best, quickest)
    side = "lower" if lower >= 0 else "higher"
    return (
        f"{quickest.method} takes {quickest.train_s:.1f} s and is {abs(lower):.2f} dB {side} on"
        f" average, which is not told from chance {_among(n)}"
    )


def _among(n: int) -> str:
    """The family of comparisons that the claim holds for."""
    return "by these seeds" if n == 1 else f"among the {n + 1} choices within that time"
