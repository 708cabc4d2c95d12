"""What stands behind the verdict, a sentence each: who is really different, who could not be told
apart, what to expect on other scenes, who is steadier, and at what cost. What was not found is told
with what the study could have found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from framework.report.statistics.compare import Comparison, compare
from framework.report.statistics.numbers import mean_text
from framework.report.statistics.outcomes import Outcomes, by_pair
from framework.report.study.collect import Study
from framework.report.study.labels import listed
from framework.report.study.roles import CHOSE, role
from framework.report.verdict.lead import amount, best_method, has_budgets, inside, where
from framework.report.verdict.steady import steady_sentence

MOST_NAMED = 8  # of methods that could not be told apart


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


def _different(study: Study, tested: Sequence[Comparison]) -> str:
    """Every method that is shown to be better or worse than its baseline, by name."""
    clear = sorted((c for c in tested if c.significant), key=lambda c: c.difference)
    if not tested:
        return ""
    if not clear:
        return f"Really different from {_bases(tested)} {where(study)}: nobody."
    told = "; ".join(f"{c.method} {amount(c)}" for c in clear)
    return f"Really different from {_bases(tested)} {where(study)}: {told}."


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
    named = [f"{c.method} ({inside(c.joint)})" for c in rest[:MOST_NAMED]]
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
        said = "; ".join(f"{c.method} {c.difference:+.2f} dB ({inside(c.like_joint)})"
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
    scenes = [scene for scene in study.tested if role(study.name_of(scene)) != CHOSE]
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


def _bases(tested: Sequence[Comparison]) -> str:
    bases = list(dict.fromkeys(c.baseline for c in tested))
    return bases[0] if len(bases) == 1 else "the baseline of its budget"
