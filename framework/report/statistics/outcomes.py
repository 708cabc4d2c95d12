"""What a study found, as numbers: spreads over seeds and paired comparisons.

Over several scenes, a seed's PSNR is the mean over the scenes, for seeds that finished on all.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from framework.report.statistics.estimates import (
    Comparison,
    Interval,
    Spread,
    compare,
    holm,
    spread,
)
from framework.report.statistics.variance import SigmaComparison, compare_sigmas, mean_deviation
from framework.report.study.collect import ReportRun, Study


@dataclass(frozen=True)
class Outcomes:
    """By method. psnr: over all scenes, without methods that have no complete seed. scene_sigma:
    mean over the scenes of their standard deviations, of several scenes. comparisons, sigmas: with
    the baseline of the same budget, where they share a (scene, seed)."""

    psnr: dict[str, Spread]
    scene_sigma: dict[str, tuple[float, Interval]]
    comparisons: dict[str, Comparison]
    sigmas: dict[str, SigmaComparison]


def outcomes(study: Study) -> Outcomes:
    """The outcomes of all methods."""
    values = {m: seed_means(study.of(method=m), study.scenes) for m in study.methods}
    psnr = {method: spread(list(found.values())) for method, found in values.items() if found}
    sigmas = {
        method: compare_sigmas(method, list(values[method].values()), base, others)
        for method in study.methods
        if (base := study.baseline_of(method)) != method and (others := list(values[base].values()))
    }
    return Outcomes(
        psnr,
        _scene_sigmas(study) if len(study.scenes) > 1 else {},
        corrected(_comparisons(study)),
        corrected({m: c for m, c in sigmas.items() if c is not None}),
    )


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


def _comparisons(study: Study) -> dict[str, Comparison]:
    values = {method: by_pair(study.of(method=method)) for method in study.methods}
    found = {
        method: compare(method, values[method], base, values[base])
        for method in study.methods
        if (base := study.baseline_of(method)) != method
    }
    return {method: c for method, c in found.items() if c is not None}


def _scene_sigmas(study: Study) -> dict[str, tuple[float, Interval]]:
    found = {}
    for method in study.methods:
        samples = [list(by_pair(study.of(scene, method)).values()) for scene in study.scenes]
        mean = mean_deviation(samples)
        if mean is not None:
            found[method] = mean
    return found


Tested = TypeVar("Tested", Comparison, SigmaComparison)


def corrected(known: dict[str, Tested]) -> dict[str, Tested]:
    """With p corrected for all comparisons that have one."""
    tested = {method: c.p for method, c in known.items() if c.p is not None}
    p_holm = dict(zip(tested, holm(list(tested.values())), strict=True))
    return {method: replace(c, p_holm=p_holm.get(method)) for method, c in known.items()}
