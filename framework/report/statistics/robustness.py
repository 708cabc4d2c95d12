"""How often a run of a method fails.

A run fails if it ended with an error, has no finite test PSNR or did not converge: its last
evaluation is at least `FAILURE_DB` below its best. It also fails if it is at least `FAILURE_DB`
below the baseline run of the same scene, budget and seed. The interval of the failure
rate is Wilson's (1927).
"""

import math
from collections.abc import Mapping

import numpy as np
from scipy import special

from framework.report.statistics.estimates import CONFIDENCE, Interval
from framework.report.statistics.outcomes import by_pair
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study

FAILURE_DB = 1.0


def failures(study: Study, method: Method, scene: str) -> tuple[int, int]:
    """How many of the runs of a method on a scene failed, and how many there are."""
    runs = study.of(scene, method)
    lost = sum(run.method == method and run.scene == scene for run in study.failed)
    plain = study.without_rival
    reference = by_pair(plain.of(scene, plain.baseline_of(method))) if plain.has_plain else {}
    return lost + sum(has_failed(run, reference) for run in runs), lost + len(runs)


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
