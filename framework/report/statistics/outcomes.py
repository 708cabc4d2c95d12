"""What a study found, as numbers: spreads over seeds and paired comparisons.

Over several scenes, a seed's PSNR is the mean over the scenes, for seeds that finished on all.
"""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from framework.report.statistics.compare import Comparison, compare, corrected
from framework.report.statistics.estimates import Estimate, estimate
from framework.report.statistics.variance import (
    SigmaComparison,
    compare_sigmas,
    sigmas_corrected,
)
from framework.report.study.methods import PLAIN, Method
from framework.report.study.scenes import CHOSE, role
from framework.report.study.study import ReportRun, Study


@dataclass(frozen=True)
class Outcomes:
    """Results by method.

    Attributes:
        psnr: mean over all scenes, for methods with a complete seed.
        best: the method to use, see `_best`.
        comparisons, sigmas: with the baseline of the same budget, where they share a (scene, seed).
        by_scene: scene -> its comparisons, uncorrected, with several scenes.
        tested: on those scenes that chose no default, if there are others too.
    """

    best: Method
    psnr: dict[Method, Estimate]
    comparisons: dict[Method, Comparison]
    sigmas: dict[Method, SigmaComparison]
    by_scene: dict[str, dict[Method, Comparison]]
    tested: dict[Method, Comparison]


def outcomes(study: Study) -> Outcomes:
    """The outcomes of all methods."""
    values = {m: seed_means(study.of(method=m), study.tested) for m in study.methods}
    psnr = {
        method: estimate(list(by_seed.values())) for method, by_seed in values.items() if by_seed
    }
    sigmas = {
        method: compare_sigmas(method, values[method], base, others)
        for method in study.methods
        if (base := study.baseline_of(method)) != method and (others := values[base])
    }
    comparisons = corrected(_comparisons(study, study.tested))
    several = len(study.tested) > 1
    untuned = [scene for scene in study.tested if role(study.name_of(scene)) != CHOSE]
    return Outcomes(
        _best(study, psnr, comparisons),
        psnr,
        comparisons,
        sigmas_corrected({m: c for m, c in sigmas.items() if c is not None}),
        {scene: _comparisons(study, [scene]) for scene in study.tested} if several else {},
        corrected(_comparisons(study, untuned)) if 0 < len(untuned) < len(study.tested) else {},
    )


def _best(
    study: Study, psnr: Collection[Method], comparisons: Mapping[Method, Comparison]
) -> Method:
    """Choose the method to use.

    It is the best of the methods that are significantly better, on all scenes, than their baseline
    and than every other method's baseline, which may have another budget or other options. Without
    one it is the study's baseline.
    """
    better = [m for m, c in comparisons.items() if better_everywhere(study, c) and m in psnr]
    if not better:
        return study.methods[0] if study.methods else PLAIN
    values = {method: by_pair(study.of(method=method)) for method in study.methods}
    bases = {*study.baselines}

    def above(method: Method, other: Method) -> Comparison | None:
        comparison = compare(method, values[method], other, values[other])
        return comparison and replace(comparison, tests=comparisons[method].tests)

    gains: dict[Method, float] = {}
    for method in better:
        over = {base: c for base in bases - {method} if (c := above(method, base)) is not None}
        if all(c.significant and c.difference > 0 for c in over.values()):
            # all above the study's baseline, so that no one gains by the seeds that it has
            gains[method] = over.get(study.baseline, comparisons[method]).difference
    return max(gains, key=lambda method: gains[method], default=study.baseline)


def better_everywhere(study: Study, c: Comparison) -> bool:
    """Whether the method is significantly better, with seeds that it has on every scene."""
    return c.significant and c.difference > 0 and len(c.scenes) == len(study.tested)


def seed_means(
    runs: Sequence[ReportRun], scenes: Sequence[str], metric: str = "psnr"
) -> dict[int, float]:
    """Seed -> mean of `metric` over `scenes`, for seeds that have a value on each of them."""
    by_seed: dict[int, dict[str, float]] = defaultdict(dict)
    for run in runs:
        value = run.mean(metric)
        if value is not None:
            by_seed[run.seed][run.scene] = value
    wanted = set(scenes)
    return {
        seed: float(np.mean([values[scene] for scene in scenes]))
        for seed, values in sorted(by_seed.items())
        if values.keys() >= wanted
    }


def by_pair(runs: Sequence[ReportRun]) -> dict[tuple[str, int], float]:
    """(scene, seed) -> PSNR in dB, of the runs that have one."""
    values = {(run.scene, run.seed): run.mean("psnr") for run in runs}
    return {key: value for key, value in values.items() if value is not None}


def _comparisons(study: Study, scenes: Sequence[str]) -> dict[Method, Comparison]:
    runs = [run for run in study.runs if run.scene in scenes]
    values = {m: by_pair([run for run in runs if run.method == m]) for m in study.methods}
    names = {run.scene: run.scene_label.name for run in runs}
    comparisons = {
        method: compare(method, values[method], base, values[base], names)
        for method in study.methods
        if (base := study.baseline_of(method)) != method
    }
    return {method: c for method, c in comparisons.items() if c is not None}
