"""What a method does along a stress, in sentences. They claim a difference at a strength only where
the interval drawn there, corrected for all strengths, excludes zero."""

from __future__ import annotations

from collections.abc import Sequence

from framework.report.figures.stress import Limit
from framework.report.statistics.numbers import interval_text, significant
from framework.report.study.axes import Axis
from framework.report.study.labels import listed


def verdict(found: Sequence[Limit], baseline: str) -> str:
    """Which method to use, of everything that was tried along the stresses."""
    if not found:
        return "No advice: no method shares its seeds with the baseline at two strengths."
    if all(limit.found.n < 2 for limit in found):
        return "No advice: single runs cannot tell a method from chance."
    gaining = list(dict.fromkeys(limit.method for limit in found if limit.found.gains))
    if not gaining:
        return f"Use {baseline}: nothing tested was shown to be better at any strength."
    where = "where it helps" if len(gaining) == 1 else "where they help"
    return f"Use {listed(gaining, 'or')} {where} (below), {baseline} elsewhere."


def sentence(limit: Limit) -> str:
    """Where a method helps along a stress, where it costs, and how much at both ends."""
    found, axis = limit.found, limit.panel.axis
    if found.n > 1 and not found.significant:
        return (
            f"{limit.method}: not told apart at any strength ({_ends(limit)}; n = {found.n} seeds)."
        )
    if found.n < 2:
        said = _single(limit)
    else:
        parts = [_where(limit, "helps", 1), _where(limit, "costs quality", -1)]
        said = " and ".join(filter(None, parts))
    if found.gains and found.stops is not None:
        said += f", and stops helping at {_at(axis, found.stops)}"
    return f"{limit.method} {said} ({_evidence(limit)})."


def _where(limit: Limit, does: str, sign: int) -> str:
    """`helps at 9 and 6 training views`: the strengths where that is significant."""
    at = [level for level, own in zip(limit.levels, limit.found.signs, strict=True) if own == sign]
    if not at:
        return ""
    if len(at) == len(limit.levels):
        return f"{does} at every tested strength"
    axis = limit.panel.axis
    return f"{does} at {axis.at.format(listed([f'{level:g}' for level in at], 'and'))}"


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
        return f"{seeds}; the sign is beyond doubt at every tested strength"
    hardest = limit.panel.levels[-1]
    open_end = hardest in (found.interval.low, found.interval.high)
    beyond = f", open towards {_at(limit.panel.axis, hardest)}" if open_end else ""
    return f"{seeds}; 95 % interval of the turning point {interval_text(found.interval)}{beyond}"


def _ends(limit: Limit) -> str:
    """The mean gain at the weakest and at the strongest strength that was compared."""
    (first, low), (last, high) = limit.ends
    axis = limit.panel.axis
    return f"gain {low:+.2f} dB at {_at(axis, first)}, {high:+.2f} dB at {_at(axis, last)}"


def _at(axis: Axis, value: float) -> str:
    return axis.at.format(f"{float(significant(value)):g}")
