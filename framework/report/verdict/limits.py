"""What a method does along a stress, in sentences. They claim a difference at a strength only where
the interval drawn there, corrected for all strengths, methods and panels, excludes zero."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from framework.report.figures.stress import Limit, Panel
from framework.report.statistics.numbers import average, interval_text, signed, significant
from framework.report.study.axes import Axis
from framework.report.study.labels import joined, listed
from framework.report.study.runs import ReportRun
from framework.report.verdict.lead import could_hide


def verdict(found: Sequence[Limit], baseline: str) -> str:
    """The first line: which method to use, of everything that was tried along the stresses."""
    if not found:
        return "No advice: no method shares one seed with the baseline at two strengths."
    if all(limit.found.n < 2 for limit in found):
        return "No advice: single runs cannot tell a method from chance."
    above = [limit for limit in found if limit.found.gains]
    gaining = list(dict.fromkeys(limit.method for limit in above if not limit.against))
    if not gaining:
        own = "; what gains over a baseline of its own options stands below" if above else ""
        return f"Use {baseline}: nothing else was shown to be better at any strength{own}."
    where = "where it helps" if len(gaining) == 1 else "where they help"
    return f"Use {listed(gaining, 'or')} {where} (below), {baseline} elsewhere."


def behind(found: Sequence[Limit], steady: str = "") -> list[str]:
    """What stands behind it: who is really different, and by how much at most; who is not told
    apart, and what could hide. steady: who is steadier, as a sentence."""
    if all(limit.found.n < 2 for limit in found):
        return []
    told = [f"{_named(limit)} {_most(limit, found)}" for limit in found if limit.found.significant]
    clear = {limit.method for limit in found if limit.found.significant}
    rest = [limit for limit in found if limit.method not in clear]
    alike = list(dict.fromkeys(limit.method for limit in rest))
    hidden = could_hide(own for limit in rest for _, own in limit.gains)
    said = [f"Really different: {'; '.join(told) or 'nobody'}."]
    if alike:
        said.append(f"Not told apart at any strength: {joined(alike)}.{hidden}")
    return [*said, *([steady] if steady else [])]


def _most(limit: Limit, found: Sequence[Limit]) -> str:
    """`costs up to 0.41 dB (-0.68 to -0.13) at 4 training views`, and so what it gains."""
    several = len({id(other.panel) for other in found}) > 1
    on = f" on {limit.panel.title}" if several else ""
    cells = list(zip(limit.levels, limit.gains, limit.found.signs, strict=True))
    parts = []
    for does, sign in (("gains", 1), ("costs", -1)):
        own = [(sign * mean, level, inside) for level, (mean, inside), s in cells if s == sign]
        if own:
            size, level, inside = max(own, key=lambda cell: cell[0])
            upto = "up to " if len(own) > 1 else ""
            within = f" ({interval_text(inside)})" if inside else ""
            parts.append(f"{does} {upto}{size:.2f} dB{within} at {_at(limit.panel.axis, level)}")
    return " and ".join(parts) + on


def alone(panels: Sequence[Panel], method: str) -> str:
    """The verdict where a single method ran: what the stress does to it."""
    told = []
    for panel in panels:
        means = {
            level: value
            for level in panel.levels
            if (value := average([r.mean("psnr") for r in panel.runs[method].get(level, [])]))
        }
        if means:
            first, last = next(iter(means)), list(means)[-1]
            told.append(
                f"{means[first]:.2f} dB at {_at(panel.axis, first)} and {means[last]:.2f} dB at"
                f" {_at(panel.axis, last)}" + (f" of {panel.title}" if len(panels) > 1 else "")
            )
    return f"Nothing to compare: {method} reaches {'; '.join(told)}."


def weakest(panel: Panel, method: str, cost_of: Callable[[list[ReportRun]], str]) -> str:
    """Where a method is weakest along the stress, and what it costs at both ends."""
    by_level = panel.runs.get(method, {})
    means = {
        level: value
        for level, runs in by_level.items()
        if (value := average([run.mean("psnr") for run in runs])) is not None
    }
    if not means:
        return ""
    low, high = (pick(means, key=lambda level: means[level]) for pick in (min, max))
    ends = [level for level in panel.levels if level in means]
    costs = [f"{cost_of(by_level[v])} at {_at(panel.axis, v)}" for v in (ends[0], ends[-1])]
    return (
        f"Where {method} is weakest on {panel.title}: {means[low]:.2f} dB at"
        f" {_at(panel.axis, low)} (best: {means[high]:.2f} dB at {_at(panel.axis, high)}). Cost of"
        f" a training: {'; '.join(dict.fromkeys(costs))}."
    )


def sentence(limit: Limit) -> str:
    """Where a method helps along a stress, where it costs, and how much at both ends."""
    found, axis = limit.found, limit.panel.axis
    if found.n > 1 and not found.significant:
        ends = f"{_ends(limit)}; n = {found.n} seeds"
        return f"{_named(limit)}: not told apart at any strength ({ends})."
    if found.n < 2:
        said = _single(limit)
    else:
        parts = [_where(limit, "helps", 1), _where(limit, "costs quality", -1)]
        said = " and ".join(filter(None, parts))
    if found.gains and found.stops is not None:
        said += f", and stops helping at {_at(axis, found.stops)}"
    return f"{_named(limit)} {said} ({_evidence(limit)})."


def _named(limit: Limit) -> str:
    """The method, and what it is compared with where that is not the study's baseline."""
    return f"{limit.method}{f' (against {limit.against})' if limit.against else ''}"


def _where(limit: Limit, does: str, sign: int) -> str:
    """`helps at 9 and 6 training views`: the strengths where that is significant."""
    at = [level for level, own in zip(limit.levels, limit.found.signs, strict=True) if own == sign]
    if not at:
        return ""
    if len(at) == len(limit.levels):
        return f"{does} at {_every(limit)}"
    return f"{does} at {_listed(limit.panel.axis, at)}"


def _every(limit: Limit) -> str:
    """All strengths; by number where some have too few seeds in common to be compared."""
    if len(limit.levels) == len(limit.panel.levels):
        return "every tested strength"
    return _listed(limit.panel.axis, limit.levels)


def _listed(axis: Axis, levels: Sequence[float]) -> str:
    """`9 and 6 training views`."""
    return axis.at.format(listed([f"{level:g}" for level in levels], "and"))


def _single(limit: Limit) -> str:
    """The course of a single run, which claims nothing."""
    found, axis = limit.found, limit.panel.axis
    if not found.helps:
        return "is above the baseline at no tested strength"
    if found.stops is not None:
        return f"falls to the baseline at {_at(axis, found.stops)}"
    if found.starts is not None:
        return f"rises above the baseline at {_at(axis, found.starts)}"
    return "is above the baseline at every tested strength"


def _evidence(limit: Limit) -> str:
    found = limit.found
    if found.n < 2:
        return f"{_ends(limit)}; n = 1: nothing can be said about its noise"
    seeds = f"{_ends(limit)}; n = {found.n} seeds"
    if found.interval is None:
        return seeds
    hardest = limit.levels[-1]
    open_end = hardest in (found.interval.low, found.interval.high)
    beyond = f", open towards {_at(limit.panel.axis, hardest)}" if open_end else ""
    return f"{seeds}; 95 % interval of the turning point {interval_text(found.interval)}{beyond}"


def _ends(limit: Limit) -> str:
    """The mean gain at the weakest and at the strongest strength that was compared."""
    (first, low), (last, high) = limit.ends
    axis = limit.panel.axis
    return f"gain {signed(low)} dB at {_at(axis, first)}, {signed(high)} dB at {_at(axis, last)}"


def _at(axis: Axis, value: float) -> str:
    return axis.at.format(f"{float(significant(value)):g}")
