"""What stands behind the verdict, a sentence each: how far apart those may be that were not told
apart, what to expect on other scenes, at what cost, how big, and where it fails."""

from __future__ import annotations

from collections.abc import Sequence

from framework.report.statistics.compare import Comparison
from framework.report.statistics.numbers import average, mean_text
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.robustness import failure_rate, worst_case
from framework.report.study.collect import ReportRun, Study
from framework.report.study.labels import listed, outside
from framework.report.study.roles import CHOSE, role
from framework.report.verdict.lead import (
    MOST_NAMED,
    amount,
    best_method,
    has_budgets,
    inside,
    not_told_apart,
)


def points(study: Study, found: Outcomes) -> list[str]:
    """What stands behind it, a sentence each."""
    tested = [c for c in found.comparisons.values() if c.joint is not None]
    told = [
        _alike(study, found, tested),
        *_elsewhere(tested),
        _untuned(study, found),
        _cost(study, found),
        weakest(study, found),
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


def _alike(study: Study, found: Outcomes, tested: Sequence[Comparison]) -> str:
    """Within what those that are not told apart may differ."""
    rest = not_told_apart(study, found, tested) if tested else []
    if not rest:
        return ""
    named = [f"{c.method} {c.difference:+.2f} dB ({inside(c.joint)})" for c in rest[:MOST_NAMED]]
    more = len(rest) - MOST_NAMED
    others = f"; {more} more under Comparisons" if more > 0 else ""
    return (
        f"Not told apart from {_bases(rest)}, with what they may gain or cost:"
        f" {', '.join(named)}{others}."
    )


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
    """Training time and size of what to use beside those of its baseline."""
    if not found.psnr or has_budgets(study):
        return ""
    best = best_method(study, found)
    methods = list(dict.fromkeys([best, study.baseline_of(best)]))
    if len(methods) == 1 and found.comparisons:
        runner = max(found.comparisons, key=lambda m: found.comparisons[m].difference)
        methods.append(runner)
    told = [f"{method} {cost_of(study.of(method=method))}" for method in methods]
    return f"Cost of a training: {'; '.join(told)}."


def cost_of(runs: Sequence[ReportRun]) -> str:
    """`9.8 s (9.5 s of CPU) and 16128 Gaussians (226 k parameters)`, means over the runs."""
    seconds = mean_text([run.record.train_s for run in runs], 1)
    cpu = mean_text([run.record.train_cpu_s for run in runs], 1)
    gaussians = mean_text([float(run.record.gaussians) for run in runs], 0)
    parameters = mean_text([run.record.parameters / 1000 for run in runs], 0)
    return f"{seconds} s ({cpu} s of CPU) and {gaussians} Gaussians ({parameters} k parameters)"


def weakest(study: Study, found: Outcomes) -> str:
    """Where what the verdict advises is worst: scene, seed, view, and how often it failed."""
    if not found.psnr:
        return ""
    best = best_method(study, found)
    if best == study.baseline_of(best) and has_budgets(study):  # its best budget
        own = {run.method for run in study.runs if run.method_label.family == study.families[0]}
        best = max(own & found.psnr.keys(), key=lambda m: (found.psnr[m].mean, m), default=best)
    means = {
        scene: value
        for scene in study.tested
        if (value := average([run.mean("psnr") for run in study.of(scene, best)])) is not None
    }
    scene = min(means, key=lambda scene: means[scene])
    told = [f"{scene} ({means[scene]:.2f} dB on average)"] if len(means) > 1 else []
    case = worst_case(study.of(scene, best))
    if case is not None:
        told.append(
            f"its worst view is {outside(case.view)} with {case.view_psnr:.2f} dB (seed"
            f" {case.view_seed}), its worst seed {case.run_seed} with {case.run_psnr:.2f} dB"
        )
    elif values := [
        (psnr, run.seed) for run in study.of(scene, best) if (psnr := run.mean("psnr"))
    ]:
        told.append(f"its worst seed is {min(values)[1]} with {min(values)[0]:.2f} dB")
    rate = None if study.tabled else failure_rate(study, best)
    told += [f"{rate.failed} of {rate.n} runs failed"] if rate else []
    place = "" if len(means) > 1 else f" on {scene}"
    return f"Where {best} is weakest{place}: {'; '.join(told)}." if told else ""


def _bases(tested: Sequence[Comparison]) -> str:
    bases = list(dict.fromkeys(c.baseline for c in tested))
    return bases[0] if len(bases) == 1 else "the baseline of its budget"
