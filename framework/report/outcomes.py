"""What a study found, as numbers: spreads over seeds and paired comparisons.

Over several scenes, a seed's PSNR is the mean over the scenes, for seeds that finished on all.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from framework.report.collect import ReportRun, Study
from framework.report.statistics import Comparison, Spread, compare, holm, spread


@dataclass(frozen=True)
class Outcomes:
    """psnr: by method, over all scenes, without methods that have no complete seed. comparisons:
    every other method with the study's baseline, where they share a (scene, seed)."""

    psnr: dict[str, Spread]
    comparisons: dict[str, Comparison]


def outcomes(study: Study) -> Outcomes:
    """The outcomes of all methods."""
    found = {method: seed_means(study.of(method=method), study.scenes) for method in study.methods}
    psnr = {method: spread(list(values.values())) for method, values in found.items() if values}
    return Outcomes(psnr, _comparisons(study))


def seed_means(runs: list[ReportRun], scenes: list[str], metric: str = "psnr") -> dict[int, float]:
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


def _comparisons(study: Study) -> dict[str, Comparison]:
    values = {method: _by_pair(study.of(method=method)) for method in study.methods}
    found = [
        compare(method, values[method], study.baseline, values[study.baseline])
        for method in study.methods
        if method != study.baseline
    ]
    known = [c for c in found if c is not None]
    tested = [c for c in known if c.p is not None]
    corrected = dict(
        zip([c.method for c in tested], holm([c.p for c in tested if c.p is not None]), strict=True)
    )
    return {c.method: replace(c, p_holm=corrected.get(c.method)) for c in known}


def _by_pair(runs: list[ReportRun]) -> dict[tuple[str, int], float]:
    values = {(run.scene, run.seed): run.mean("psnr") for run in runs}
    return {key: value for key, value in values.items() if value is not None}
