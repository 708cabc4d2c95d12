"""What stands behind the verdict, a sentence each: how far apart those may be that were not told
apart, what to expect on other scenes, at what cost, how big, and where it fails."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

from framework.report.statistics.compare import Comparison
from framework.report.statistics.drawn import draws
from framework.report.statistics.estimates import SIGNIFICANCE
from framework.report.statistics.numbers import average, mean_text, p_text, signed
from framework.report.statistics.outcomes import Outcomes
from framework.report.statistics.robustness import failure_rate, worst_case
from framework.report.study.labels import listed, outside
from framework.report.study.roles import CHOSE, role
from framework.report.study.runs import ReportRun, Study
from framework.report.verdict.lead import (
    AS_GOOD_DB,
    alike,
    amount,
    compared,
    different,
    inside,
)
from framework.report.verdict.steady import steady_sentence

MEANING = {  # docs/methods.md has their equations
    "dba": "pseudo views warped from the nearest photo",
    "euclidean": "pseudo views warped from the nearest photos",
    "full_set": "pseudo views warped from all photos",
    "safi": "pseudo views warped from the photos that Fisher information chooses",
    "uniform": "dropout of Gaussians at random",
    "dropgaussian": "dropout of Gaussians at random that the others make up for",
    "uar_hard": "dropout of Gaussians that the photos determine well",
    "uar": "dimming of Gaussians that the photos determine well",
    "co_register_drawn": "agreement with a second field that begins as another draw",
}


def points(study: Study, found: Outcomes, beside: str = "") -> list[str]:
    """What stands behind the verdict, a sentence or two each. beside: one on how the number of
    Gaussians is decided."""
    tested = compared(found)
    told = [
        different(study, found),
        alike(study, found),
        _fewer(study, tested),
        beside,
        steady_sentence(found) if tested else "",
        _cost(study, found),
        weakest(study, found),
        *_elsewhere(tested),
        _untuned(study, found),
        _other_photos(study),
    ]
    return [text for text in told if text]


def _fewer(study: Study, tested: Sequence[Comparison]) -> str:
    """Who is compared on some of the scenes only, as the others have too few seeds in common."""
    alike: dict[Sequence[str], list[str]] = defaultdict(list)
    for c in tested:
        if len(c.scenes) < len(study.tested):
            alike[c.scenes].append(c.method)
    told = [
        f"{'all' if 1 < len(methods) == len(tested) else listed(methods, 'and')}"
        f" on {study.listed(scenes)}"
        for scenes, methods in alike.items()
    ]
    return f"Compared where two seeds or more are common: {'; '.join(told)}." if told else ""


def evidence(found: Outcomes) -> str:
    """How the numbers of the verdict are to be read; "" where nothing was tested."""
    tested = [c for c in found.comparisons.values() if c.joint is not None]
    if not tested:
        return ""
    fewest, most = (pick(c.n for c in tested) for pick in (min, max))
    seeds = f"{most}" if fewest == most else f"{fewest} to {most}"
    widened = max(c.tests for c in tested)  # with those that only several scenes can test
    once = f", widened to hold for all {widened} comparisons at once" if widened > 1 else ""
    pairs = any(" + " in c.method for c in tested)  # others have the names of their recipes
    named = f"a method is named augmenter + regularizer{_meanings(tested)}. Differences"
    return (
        f"How to read this: {named if pairs else 'differences'} are of PSNR in"
        " views that were not trained on, between runs of the same seed. In brackets: where the"
        f" true difference lies with 95 % confidence, from {seeds} seeds{once}; the thick bars"
        " below are the same. Really different: that range excludes zero. Not told apart: it"
        " includes zero, which does not prove that two are equal."
    )


def _meanings(tested: Sequence[Comparison]) -> str:
    """The report's best known parts of methods in a few words each, for who meets them here."""
    parts = {part for c in tested for part in c.method.split(",")[0].split(" + ")}
    known = [f"{part} is {MEANING[part]}" for part in MEANING if part in parts]
    return f" ({'; '.join(known)})" if known else ""


def _elsewhere(tested: Sequence[Comparison]) -> list[str]:
    """What holds beyond these scenes."""
    told = []
    clear = [c for c in tested if c.significant]
    over = [c for c in tested if c.like_joint is not None]
    if over:
        scenes = max(c.like.n for c in over if c.like)
        shown = [c for c in over if c.general]
        said = "; ".join(f"{c.method} {signed(c.like.mean)} dB ({inside(c.like_joint)})"
                         for c in (shown or clear) if c.like)  # fmt: skip
        start = f"To be expected on other scenes, judged by how these {scenes} differ"
        if shown:
            told.append(f"{start}: {said}; nothing is shown about the other methods.")
        else:
            told.append(f"{start}: no difference is shown{'; ' + said if said else ''}.")
    return told


def _untuned(study: Study, found: Outcomes) -> str:
    """What is different on those scenes alone where no default was chosen."""
    alone = [c for c in found.tested.values() if c.joint is not None]
    if not alone:
        return ""
    scenes = [scene for scene in study.tested if role(study.name_of(scene)) != CHOSE]
    own = [f"{c.method} {amount(c)}" for c in alone if c.significant]
    said = "; ".join(own) if own else "nobody is told apart"
    return f"On {study.listed(scenes)} alone, where no test photo chose a default: {said}."


def _other_photos(study: Study) -> str:
    """Where a gain is shown to depend on the photos that were drawn, corrected for all that were
    tested; "" where nothing could be."""
    tested = [(d.alike.p, d) for d in draws(study) if d.alike is not None and d.alike.p is not None]
    if not tested:
        return ""
    sure = [(len(tested) * p, d) for p, d in tested if len(tested) * p < SIGNIFICANCE]
    if not sure:
        return "With other photos of a scene: no gain is shown to depend on which were drawn."
    told = [
        f"{d.method} on {d.scene} {signed(min(d.gains))} to {signed(max(d.gains))} dB over"
        f" {len(d.gains)} draws ({p_text(p)}), {signed(d.over.mean)} in the mean"
        for p, d in sorted(sure, key=lambda pair: pair[0])
    ]
    return f"What is gained depends on which photos one has: {'; '.join(told)}."


def _cost(study: Study, found: Outcomes) -> str:
    """Training time and size of what to use beside those of its baseline."""
    if not found.psnr:
        return ""
    if study.has_budgets:
        return _cost_of_budgets(study, found)
    best = found.best
    methods = list(dict.fromkeys([best, study.baseline_of(best)]))
    if len(methods) == 1 and found.comparisons:
        runner = max(found.comparisons, key=lambda m: found.comparisons[m].difference)
        methods.append(runner)
    told = [f"{method} {cost_of(study.of(method=method))}" for method in methods]
    return f"Cost of a training: {'; '.join(told)}."


def _cost_of_budgets(study: Study, found: Outcomes) -> str:
    """Of the advised family, what its cheapest and its dearest budget take."""
    family = study.family_of[found.best]
    own = [method for method in found.psnr if study.family_of[method] == family]
    seconds = {
        method: value
        for method in own
        if (value := average([run.record.train_cpu_s for run in study.of(method=method)]))
    }
    if not seconds:
        return ""
    ends = [pick(seconds, key=lambda method: seconds[method]) for pick in (min, max)]
    told = [f"{method} {cost_of(study.of(method=method))}" for method in dict.fromkeys(ends)]
    return f"Cost of a training of {family}, cheapest and dearest: {'; '.join(told)}."


def cost_of(runs: Sequence[ReportRun]) -> str:
    """`9.8 s (9.5 s of CPU) and 16,128 Gaussians (226 k parameters)`, means over the runs."""
    seconds = mean_text([run.record.train_s for run in runs], 1)
    cpu = mean_text([run.record.train_cpu_s for run in runs], 1)
    gaussians = f"{average([float(run.record.gaussians) for run in runs]) or 0:,.0f}"
    parameters = f"{average([run.record.parameters / 1000 for run in runs]) or 0:,.0f}"
    return f"{seconds} s ({cpu} s of CPU) and {gaussians} Gaussians ({parameters} k parameters)"


def _quick_and_good(study: Study, found: Outcomes, methods: Iterable[str]) -> str | None:
    """The cheapest of those that are nearly as good as the best of them."""
    means = {method: found.psnr[method].mean for method in methods}
    good = [method for method, mean in means.items() if mean >= max(means.values()) - AS_GOOD_DB]

    def cost(method: str) -> tuple[float, str]:
        cpu = average([run.record.train_cpu_s for run in study.of(method=method)])
        return (math.inf if cpu is None else cpu, method)

    return min(good, key=cost, default=None)


def weakest(study: Study, found: Outcomes) -> str:
    """Where what the verdict advises is worst: scene, seed, view, and how often it failed."""
    if not found.psnr:
        return ""
    best = found.best
    if best == study.baseline_of(best) and study.has_budgets:  # its best budget
        own = {run.method for run in study.runs if run.method_label.family == study.families[0]}
        best = _quick_and_good(study, found, own & found.psnr.keys()) or best
    means = {
        scene: value
        for scene in study.tested
        if (value := average([run.mean("psnr") for run in study.of(scene, best)])) is not None
    }
    if not means:
        return ""
    scene = min(means, key=lambda scene: means[scene])
    told = [f"{scene} ({means[scene]:.2f} dB on average)"] if len(means) > 1 else []
    runs = study.of(scene, best)
    case, several = worst_case(runs), len({run.seed for run in runs}) > 1
    if case is not None:
        view = f"its worst view is {outside(case.view)} with {case.view_psnr:.2f} dB"
        seed = (
            f" (seed {case.view_seed}), its worst seed {case.run_seed} with {case.run_psnr:.2f} dB"
        )
        told.append(view + (seed if several else ""))
    elif several and (values := [(psnr, r.seed) for r in runs if (psnr := r.mean("psnr"))]):
        told.append(f"its worst seed is {min(values)[1]} with {min(values)[0]:.2f} dB")
    rate = failure_rate(study, best) if study.has_views else None
    told += [f"{rate.failed} of {rate.n} runs failed"] if rate and rate.n > 1 else []
    place = "" if len(means) > 1 else f" on {scene}"
    return f"Where {best} is weakest{place}: {'; '.join(told)}." if told else ""
