"""The worst case: worst view and seed, 5th percentile, and how often a run fails.

A run fails if it ended with an error, has no finite test PSNR or did not converge: its last
evaluation is at least `FAILURE_DB` below its best. It also fails if it is at least `FAILURE_DB`
below the baseline run of the same scene, budget and seed. The interval of the failure
rate is Wilson's (1927).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from framework.report.statistics.estimates import CONFIDENCE, Interval
from framework.report.statistics.outcomes import by_pair
from framework.report.study.methods import Method
from framework.report.study.study import FailedRun, ReportRun, Study

FAILURE_DB = 1.0
PERCENTILE = 5.0


@dataclass(frozen=True)
class WorstCase:
    """Worst results in dB over the test views of all runs of a method on a scene.

    They are the worst mean of a run with its seed, the worst view with its name and seed, and the
    5th percentile of views.
    """

    run_psnr: float
    run_seed: int
    view_psnr: float
    view: str
    view_seed: int
    percentile: float


@dataclass(frozen=True)
class FailureRate:
    """failed of n runs, with the interval of the share."""

    failed: int
    n: int
    interval: Interval


def worst_case(runs: Sequence[ReportRun]) -> WorstCase | None:
    """Find the view with the lowest PSNR; None if no view of these runs has a finite PSNR."""
    views = [
        (psnr, run.seed, view)
        for run in runs
        for view, psnr in run.psnr.items()
        if not math.isnan(psnr)
    ]
    means = [(psnr, run.seed) for run in runs if (psnr := run.mean("psnr")) is not None]
    if not views or not means:
        return None
    lowest, view_seed, view = min(views)
    percentile = float(np.percentile([psnr for psnr, _, _ in views], PERCENTILE))
    return WorstCase(*min(means), lowest, view, view_seed, percentile)


def failure_rate(study: Study, method: Method, scene: str | None = None) -> FailureRate | None:
    """The share of failed runs of a method; None where it has no run."""
    runs = study.of(scene, method)
    lost = [run for run in study.failed if _is_of(run, scene, method)]
    plain = study.without_rival
    reference = by_pair(plain.of(scene, plain.baseline_of(method))) if plain.has_plain else {}
    n = len(runs) + len(lost)
    if n == 0:
        return None
    failed = len(lost) + sum(has_failed(run, reference) for run in runs)
    return FailureRate(failed, n, wilson(failed, n))


def has_failed(run: ReportRun, reference: Mapping[tuple[str, int], float]) -> bool:
    """reference: (scene, seed) -> PSNR of `none + none`."""
    if not run.tested:
        return False
    psnr = run.mean("psnr")
    if psnr is None or not _has_converged(run):
        return True
    other = reference.get((run.scene, run.seed))
    # to 1e-9 dB, so that rounding does not decide
    return other is not None and psnr <= other - FAILURE_DB + 1e-9


def wilson(failed: int, n: int) -> Interval:
    """Wilson's score interval of a share."""
    z = float(special.ndtri((1 + CONFIDENCE) / 2))
    share, weight = failed / n, z * z / n
    middle = (share + weight / 2) / (1 + weight)
    half = z * math.sqrt(share * (1 - share) / n + weight / (4 * n)) / (1 + weight)
    # exact at the ends, where rounding would leave 1 - 1e-16
    low = 0.0 if failed == 0 else max(0.0, middle - half)
    return Interval(low, 1.0 if failed == n else min(1.0, middle + half))


def _has_converged(run: ReportRun) -> bool:
    psnr = run.run.history.numbers["test_psnr"]
    psnr = psnr[~np.isnan(psnr)]
    return len(psnr) == 0 or bool(psnr[-1] > psnr.max() - FAILURE_DB)


def _is_of(run: FailedRun, scene: str | None, method: Method) -> bool:
    return run.method == method and scene in (None, run.scene)
