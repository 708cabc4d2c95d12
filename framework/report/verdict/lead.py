"""The first lines of a report: what to use, who is really different, and who is not told apart.

A difference is claimed where its interval excludes zero, and the interval is the one the charts
draw: corrected for all comparisons of the report.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace

from framework.report.statistics.compare import Comparison, compare
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import decimals, interval_text, signed, significant
from framework.report.statistics.outcomes import Outcomes, by_pair
from framework.report.study.labels import listed
from framework.report.study.order import BASELINE
from framework.report.study.runs import Study

MOST_NAMED = 8  # of methods that could not be told apart
AS_GOOD_DB = 0.1  # a mean so much below the best counts as good
LEAST_DB = 0.005  # a smaller difference reads as 0.00
NOTHING_BETTER = ": nothing else was shown to be better"
NOT_BETTER_EQUAL = ": no other method was shown to be better at an equal budget"
SOME_GAIN = (
    ": nothing was shown to be better than it; what gains over a baseline of its own stands below"
)

UNTESTED = (
    "Nothing was tested: no photo was held out (scene.split=none), so nothing is known of the"
    " quality in other views, and methods cannot be compared."
)


def lead(study: Study, found: Outcomes, budget: str = "") -> str:
    """What to use, in a line. budget: which one of the advised method to take, for studies of
    several."""
    if not study.runs:
        return "No run of this study finished."
    if not study.tested:
        return UNTESTED
    if not found.psnr:
        return "No method of this study finished on every scene with a finite PSNR."
    if len(study.methods) == 1:
        return f"Nothing to compare: {_level(study, found)}."
    if not compared(found):
        return f"No advice: {_untested(study, found)}"
    return _use(study, found, budget)


def compared(found: Outcomes) -> list[Comparison]:
    """The comparisons that more than single runs were made for."""
    return [c for c in found.comparisons.values() if c.joint is not None]


def _use(study: Study, found: Outcomes, budget: str) -> str:
    best = found.best
    if best != study.baseline:
        c = found.comparisons[best]
        timed = study.has_budgets and comparable(study)
        less = "; what to use for less time stands below" if timed else ""
        return f"Use {best}: it {amount(c)} against {plainly(c.baseline)} {where(study, c)}{less}."
    if study.rival and not _others(study, found, ""):  # what somebody named is no advice
        return f"Nothing was shown to be better than {plainly(best)} {where(study)}."
    if study.has_budgets:
        base = plainly(study.families[0])
        # of one family there are only budgets, which the next lines compare
        other = _others(study, found, NOT_BETTER_EQUAL) if len(study.families) > 1 else ""
        return f"Use {base} {where(study)}{budget}{other}."
    return f"Use {plainly(best)} {where(study)}{_others(study, found, NOTHING_BETTER)}."


def _others(study: Study, found: Outcomes, nothing: str) -> str:
    """Why the baseline is advised: what gains, if anything does, and what it is not shown to be
    better than."""
    gains = [c for c in found.comparisons.values() if c.significant and c.difference > 0]
    over = [c.method for c in gains if c.baseline == study.baseline]
    whole = [method for method in over if method in found.psnr]
    if over and not whole:
        does = "is" if len(over) == 1 else "are"
        return f": {listed(over, 'and')} {does} better than it where compared, not on all scenes"
    if over := whole:
        does = "is better than it, but is" if len(over) == 1 else "are better than it, but are"
        every = "every baseline" if study.rival else "every plain training"
        return f": {listed(over, 'and')} {does} not shown to be better than {every}"
    return SOME_GAIN if gains else nothing


def different(study: Study, found: Outcomes) -> str:
    """Every method that is shown to be better or worse than its baseline, but the advised one."""
    tested = compared(found)
    if not tested:
        return ""
    clear = sorted((c for c in tested if c.significant and c.method != found.best), key=_difference)
    than, several = _than(study, tested), len(_base_families(study, tested)) > 1
    named = [
        f"{c.method} {amount(c)}" + (f" against {c.baseline}" if several else "") for c in clear
    ]
    told = "; ".join(named)
    nobody = "nobody else" if found.best in found.comparisons else "nobody"
    return f"Really different{than}: {told or nobody}."


def _than(study: Study, tested: Sequence[Comparison]) -> str:
    """` from none + none`, with what `tested` compares."""
    bases = {c.baseline for c in tested}
    if len(bases) == 1:
        return f" from {bases.pop()}"
    return " at an equal budget" if study.has_budgets and len(study.families) > 1 else ""


def _base_families(study: Study, tested: Sequence[Comparison]) -> set[str]:
    """The baselines of `tested` without their budgets: several where options of theirs differ."""
    return {study.family_of[c.baseline] for c in tested}


def alike(study: Study, found: Outcomes) -> str:
    """Who is not told apart from the advised one, by name, and how large a difference the study
    may have missed."""
    tested = compared(found)
    if study.has_budgets:
        rest = [c for c in tested if not c.significant]
        hidden = could_hide(c.joint for c in rest)
        families = "; ".join(_by_family(study, rest, tested))
        told = f"Not told apart{_than(study, tested)}: {families}.{hidden}"
        return told if rest else ""
    rest = not_told_apart(study, found, tested) if tested else []
    if not rest:
        return ""
    named = [f"{c.method} {signed(c.difference)} dB ({inside(c.joint)})" for c in rest[:MOST_NAMED]]
    hidden = could_hide(c.joint for c in rest)
    more = len(rest) - MOST_NAMED
    named += [f"{more} more under Comparisons"] if more > 0 else []
    return f"Not told apart from {rest[0].baseline}: {'; '.join(named)}.{hidden}"


def could_hide(intervals: Iterable[Interval | None]) -> str:
    """The largest difference that the intervals of what is not told apart leave open."""
    most = max((max(-own.low, own.high) for own in intervals if own), default=0.0)
    return f" A difference of up to {significant(most)} dB could hide." if most >= LEAST_DB else ""


def _by_family(study: Study, rest: Sequence[Comparison], tested: Sequence[Comparison]) -> list[str]:
    """Of methods with several budgets, at how many of them, and their differences."""
    every = Counter(study.family_of[c.method] for c in tested)
    told = []
    for family in dict.fromkeys(study.family_of[c.method] for c in rest):
        own = [c.difference for c in rest if study.family_of[c.method] == family]
        share = f"{len(own)} of its" if len(own) < every[family] else "all its"
        at = "" if every[family] == 1 else f" at {share} {every[family]} budgets"
        low, high = signed(min(own)), signed(max(own))
        means = f"{low} dB on average" if low == high else f"averages from {low} to {high} dB"
        told.append(f"{family}{at} ({means})")
    return told


def not_told_apart(study: Study, found: Outcomes, tested: Sequence[Comparison]) -> list[Comparison]:
    """What could not be told from what the verdict says to use, the highest first."""
    best = found.best
    own = all(c.baseline == best for c in tested)
    over = tested if own else _against(study, found, best)
    return sorted((c for c in over if not c.significant), key=lambda c: -c.difference)


def _against(study: Study, found: Outcomes, best: str) -> list[Comparison]:
    """The other methods against the best one, corrected for all of them, but its own baseline where
    the verdict tells that difference."""
    values = {method: by_pair(study.of(method=method)) for method in (*found.psnr, best)}
    others = [compare(m, values[m], best, values[best]) for m in found.psnr if m != best]
    known = [c for c in others if c is not None and c.joint is not None]
    # the verdict tells it of its own baseline, corrected for the other comparisons with that
    beaten = found.comparisons.get(best)
    told = beaten.baseline if beaten is not None and beaten.significant else best
    return [replace(c, tests=len(known)) for c in known if c.method != told]


def _difference(c: Comparison) -> float:
    return c.difference


def one_machine(study: Study, scene: str) -> bool:
    """Whether one kind of machine did all runs of a scene, so that their seconds compare."""
    return len({run.machine for run in study.of(scene)}) < 2


def comparable(study: Study) -> bool:
    """Whether something is advised by time on some scene."""
    return any(one_machine(study, scene) for scene in study.tested)


def plainly(method: str) -> str:
    """A method's name; the plain one says that it is."""
    return f"{method} (plain training)" if method == BASELINE else method


def amount(c: Comparison) -> str:
    """`costs 0.10 dB (-0.14 to -0.06)`."""
    assert c.joint is not None, "only what was tested is told"
    does = "gains" if c.difference >= 0 else "costs"
    return f"{does} {signed(c.difference).lstrip('+-')} dB ({interval_text(c.joint)})"


def where(study: Study, of: Comparison | None = None) -> str:
    """`on fern`, `on these 5 scenes`; where a comparison is of fewer, `on 3 of these 5 scenes`."""
    scenes = study.tested
    these = f"these {study.counted(scenes)}"
    if of is not None and len(of.scenes) < len(scenes):
        if len(of.scenes) == 1:
            return f"on {of.scenes[0]} alone of {these}"
        return f"on {len(of.scenes)} of {these}"
    return f"on {scenes[0]}" if len(scenes) == 1 else f"on {these}"


def _level(study: Study, found: Outcomes) -> str:
    (method,) = study.methods
    only = found.psnr[method]
    where = (
        study.tested[0] if len(study.tested) == 1 else f"the mean of {study.counted(study.tested)}"
    )
    if only.mean_interval is None or only.sd is None:
        return (
            f"on {where}, {plainly(method)} reaches {only.mean:.2f} dB in a single run (n = 1),"
            " which says nothing about its stability"
        )
    half = (only.mean_interval.high - only.mean_interval.low) / 2
    return (
        f"on {where}, {plainly(method)} reaches {only.mean:.{decimals(half, 2)}f} dB"
        f" ({inside(only.mean_interval)}, 95 %, n = {only.n} seeds, σ_PSNR"
        f" {significant(only.sd)} dB)"
    )


def _untested(study: Study, found: Outcomes) -> str:
    """Why nothing is advised: single runs, or no seed in common."""
    best = max(found.psnr, key=lambda method: found.psnr[method].mean)
    reach = f"highest is {best} with {found.psnr[best].mean:.2f} dB"
    c = found.comparisons.get(best)
    if not found.comparisons:
        mend = "" if study.rival else " (method=baseline beside the others makes one)"
        return (
            f"{study.baseline} has no run of the same scene, seed and options as another method, so"
            f" nothing is compared{mend}; {reach}."
        )
    if c is not None:
        side = "above" if c.difference >= 0 else "below"
        reach += f", {abs(c.difference):.2f} dB {side} {c.baseline}"
    return f"single runs cannot tell a method from chance; {reach}."


def inside(interval: Interval | None) -> str:
    """An interval as text; "" where there is none."""
    return "" if interval is None else interval_text(interval)
