"""The verdict: what to use, what is really different, what could not be told apart.

A difference is claimed where its interval excludes zero, and the interval is the one the charts
draw: corrected for all comparisons of the report. What was not found is told with what the study
could have found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from framework.report.statistics.compare import Comparison, compare
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import decimals, interval_text, mean_text, significant
from framework.report.statistics.outcomes import Outcomes, by_pair
from framework.report.study.collect import Study
from framework.report.study.labels import listed
from framework.report.study.order import BASELINE
from framework.report.study.roles import CHOSE, role
from framework.report.text.steady import steady_sentence

MOST_NAMED = 8  # of methods that could not be told apart


def lead(study: Study, found: Outcomes) -> str:
    """What to use, in a sentence."""
    if not study.runs:
        return "No run of this study finished."
    if not found.psnr:
        return "No method of this study finished on every scene with a finite PSNR."
    if len(study.methods) == 1:
        return f"Nothing to compare: {_level(study, found)}."
    tested = [c for c in found.comparisons.values() if c.joint is not None]
    if not tested:
        return f"No advice: {_untested(study, found)}"
    best = best_method(study, found)
    if best == study.baseline_of(best) and has_budgets(study):
        return (
            f"Use {plainly(study.families[0])} at the budget that suits you (below): nothing tested"
            " was shown to be better at an equal one."
        )
    if best == study.baseline_of(best):
        return f"Use {plainly(best)}: nothing tested was shown to be better."
    c = found.comparisons[best]
    return f"Use {best}: it {amount(c)} against {plainly(c.baseline)} {_where(study)}."


def points(study: Study, found: Outcomes) -> list[str]:
    """What stands behind it, a sentence each: really different, not told apart, on other scenes,
    steadier, and at what cost."""
    tested = [c for c in found.comparisons.values() if c.joint is not None]
    told = [
        _different(study, tested),
        _alike(study, found, tested),
        *_elsewhere(tested),
        _untuned(study, found),
        steady_sentence(found),
        _cost(study, found),
    ]
    return [text for text in told if text]


def evidence(found: Outcomes) -> str:
    """How the numbers of the verdict are to be read; "" where nothing was tested."""
    tested = [c for c in found.comparisons.values() if c.joint is not None]
    if not tested:
        return ""
    fewest, most = (pick(c.n for c in tested) for pick in (min, max))
    seeds = f"{most}" if fewest == most else f"{fewest} to {most}"
    once = f" and hold for all {len(tested)} comparisons at once" if len(tested) > 1 else ""
    return (
        "A method is named augmenter + regularizer. Differences of test PSNR, paired by seed; in"
        f" brackets intervals of 95 %, which are over {seeds} seeds{once}: the thick bars below."
    )


def has_budgets(study: Study) -> bool:
    """Whether methods ran with several budgets, of which time decides."""
    return any(run.method_label.budget for run in study.runs)


def best_method(study: Study, found: Outcomes) -> str:
    """The highest of those shown to be better than their baseline, else the baseline."""
    better = [
        method
        for method, c in found.comparisons.items()
        if c.significant and c.difference > 0 and method in found.psnr
    ]
    if not better:
        return study.baseline
    return max(better, key=lambda method: found.psnr[method].mean)


def plainly(method: str) -> str:
    """A method's name; the plain one says that it is."""
    return f"{method} (plain training)" if method == BASELINE else method


def amount(c: Comparison) -> str:
    """`costs 0.10 dB (-0.14 to -0.06)`."""
    assert c.joint is not None, "only what was tested is told"
    places = decimals((c.joint.high - c.joint.low) / 2, 2)
    does = "gains" if c.difference >= 0 else "costs"
    return f"{does} {abs(c.difference):.{places}f} dB ({interval_text(c.joint)})"


def _different(study: Study, tested: Sequence[Comparison]) -> str:
    """Every method that is shown to be better or worse than its baseline, by name."""
    clear = sorted((c for c in tested if c.significant), key=lambda c: c.difference)
    if not tested:
        return ""
    if not clear:
        return f"Really different from {_bases(tested)} {_where(study)}: nobody."
    one = len({c.baseline for c in clear}) == 1
    told = [f"{c.method} {amount(c)}" + ("" if one else f" against {c.baseline}") for c in clear]
    of = f" from {_bases(clear)}" if one else ""
    return f"Really different{of} {_where(study)}: {'; '.join(told)}."


def _alike(study: Study, found: Outcomes, tested: Sequence[Comparison]) -> str:
    """Who could not be told from what the verdict says to use."""
    if not tested:
        return ""
    best = best_method(study, found)
    rest = [c for c in tested if not c.significant]
    if best != study.baseline_of(best):
        rest = [c for c in _against(study, found, best) if not c.significant]
    if not rest:
        return f"Not told apart from {best}: nobody." if best in found.comparisons else ""
    rest.sort(key=lambda c: -c.difference)
    named = [f"{c.method} ({_inside(c.joint)})" for c in rest[:MOST_NAMED]]
    more = len(rest) - MOST_NAMED
    others = f"; {more} more under Comparisons" if more > 0 else ""
    of = best if best != study.baseline_of(best) else _bases(rest)
    return f"Not told apart from {of}: {', '.join(named)}{others}."


def _against(study: Study, found: Outcomes, best: str) -> list[Comparison]:
    """Every other method against the best one, corrected for all of them."""
    values = {method: by_pair(study.of(method=method)) for method in found.psnr}
    others = [compare(m, values[m], best, values[best]) for m in found.psnr if m != best]
    known = [c for c in others if c is not None and c.joint is not None]
    return [replace(c, tests=len(known)) for c in known]


def _elsewhere(tested: Sequence[Comparison]) -> list[str]:
    """What holds beyond these scenes."""
    told = []
    clear = [c for c in tested if c.significant]
    over = [c for c in tested if c.like_joint is not None]
    if over:
        scenes = max(c.scenes for c in over)
        shown = [c for c in over if c.general]
        said = "; ".join(f"{c.method} {c.difference:+.2f} dB ({_inside(c.like_joint)})"
                         for c in (shown or clear))  # fmt: skip
        start = f"Expected on other scenes like these {scenes} (intervals over scenes)"
        if shown:
            told.append(f"{start}: {said}; of no other method.")
        else:
            told.append(f"{start}: nothing is shown{': ' + said if said else ''}.")
    return told


def _untuned(study: Study, found: Outcomes) -> str:
    """What is different on those scenes alone where no default was chosen."""
    alone = [c for c in found.tested.values() if c.joint is not None]
    if not alone:
        return ""
    scenes = [scene for scene in study.scenes if role(study.name_of(scene)) != CHOSE]
    own = [f"{c.method} {amount(c)}" for c in alone if c.significant]
    said = "; ".join(own) if own else "nobody is told apart"
    return f"On {listed(scenes, 'and')} alone, where no default was chosen: {said}."


def _cost(study: Study, found: Outcomes) -> str:
    """Training time and Gaussians of what to use beside those of its baseline."""
    if not found.psnr or has_budgets(study):
        return ""
    best = best_method(study, found)
    methods = list(dict.fromkeys([best, study.baseline_of(best)]))
    if len(methods) == 1 and found.comparisons:
        runner = max(found.comparisons, key=lambda m: found.comparisons[m].difference)
        methods.append(runner)
    told = []
    for method in methods:
        runs = study.of(method=method)
        seconds = mean_text([run.record.train_s for run in runs], 1)
        cpu = mean_text([run.record.train_cpu_s for run in runs], 1)
        gaussians = mean_text([float(run.record.gaussians) for run in runs], 0)
        told.append(f"{method} {seconds} s ({cpu} s of CPU) and {gaussians} Gaussians")
    return f"Cost of a training: {'; '.join(told)}."


def _level(study: Study, found: Outcomes) -> str:
    (method,) = study.methods
    only = found.psnr[method]
    where = study.scenes[0] if len(study.scenes) == 1 else f"the mean of {len(study.scenes)} scenes"
    if only.mean_interval is None or only.sd is None:
        return (
            f"on {where}, {plainly(method)} reaches {only.mean:.2f} dB in a single run (n = 1),"
            " which says nothing about its stability"
        )
    half = (only.mean_interval.high - only.mean_interval.low) / 2
    return (
        f"on {where}, {plainly(method)} reaches {only.mean:.{decimals(half, 2)}f} dB"
        f" ({_inside(only.mean_interval)}, 95 %, n = {only.n} seeds, σ_PSNR"
        f" {significant(only.sd)} dB)"
    )


def _untested(study: Study, found: Outcomes) -> str:
    """Why nothing is advised: single runs, or no seed in common."""
    best = max(found.psnr, key=lambda method: found.psnr[method].mean)
    reach = f"highest is {best} with {found.psnr[best].mean:.2f} dB"
    c = found.comparisons.get(best)
    if not found.comparisons:
        return f"no method shares a seed with {study.baseline}, so nothing is compared; {reach}."
    if c is not None:
        side = "above" if c.difference >= 0 else "below"
        reach += f", {abs(c.difference):.2f} dB {side} {c.baseline}"
    return f"single runs cannot tell a method from chance; {reach}."


def _bases(tested: Sequence[Comparison]) -> str:
    bases = list(dict.fromkeys(c.baseline for c in tested))
    return bases[0] if len(bases) == 1 else "the baseline of its budget"


def _where(study: Study) -> str:
    scenes = study.scenes
    return f"on {scenes[0]}" if len(scenes) == 1 else f"on these {len(scenes)} scenes"


def _inside(interval: Interval | None) -> str:
    return "" if interval is None else interval_text(interval)
