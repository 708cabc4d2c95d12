"""Stability: do the standard deviations over seeds of two methods differ, and how many seeds would
show it?

Methods that share seeds are tested by Pitman and Morgan (1939). A seed changes both alike, so their
values are pairs. If the deviations are equal, differences and sums of the pairs are uncorrelated. A
t test checks this for the values and for their ranks, because one outlier can cause a correlation
of values. p is the larger one.

The interval of their ratio q is q sqrt(k -+ sqrt(k^2 - 1)), k = 1 + 2 (1 - r^2) t^2 / (n - 2), with
the correlation r within pairs. It contains the ratios that the test of values does not reject, for
normal errors.

Methods that share fewer than three seeds are tested by Brown and Forsythe (1974), an F test on the
absolute distances from the median. The interval is sd_a / sd_b over the quantiles of F(n_a - 1, n_b
- 1).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy import special

from framework.report.statistics.estimates import (
    CONFIDENCE,
    SIGNIFICANCE,
    Interval,
    deviation,
    t_quantile,
)
from framework.report.statistics.power import detectable, uncorrelated
from framework.report.study.methods import Method

M = TypeVar("M")
MOST_ALIKE = 1 - 1e-9  # a correlation of exactly 1 would leave no noise to test against


@dataclass(frozen=True)
class SigmaComparison:
    """Ratio of two standard deviations.

    Attributes:
        ratio: sd of `method` / sd of `baseline` with its interval; None if one is 0.
        steadier: whether the first is smaller.
        p: of the test.
        n, other_n: seeds of both.
        rho: correlation of the pairs that share a seed; None for samples compared as independent.
        tests: how many comparisons `p_joint` is corrected for (Bonferroni).
    """

    method: Method
    baseline: Method
    ratio: float | None
    interval: Interval | None
    p: float
    n: int
    other_n: int
    steadier: bool
    rho: float | None = None
    tests: int = 1

    @property
    def paired(self) -> bool:
        return self.rho is not None

    @property
    def p_joint(self) -> float:
        return min(1.0, self.tests * self.p)

    @property
    def significant(self) -> bool:
        return self.p_joint < SIGNIFICANCE

    @property
    def detectable(self) -> float | None:
        """The ratio below 1 that this test finds in 80 % of such studies; None: it finds none."""
        return detectable(self.n, self.other_n, self.tests, self.rho)


def compare_sigmas(
    method: Method, values: Mapping[int, float], baseline: Method, others: Mapping[int, float]
) -> SigmaComparison | None:
    """The standard deviations of two samples by seed, of the seeds that both have if these are
    three or more; None where one has fewer than three values."""
    if min(len(values), len(others)) < 3:
        return None
    seeds = sorted(values.keys() & others.keys())
    paired = len(seeds) >= 3
    a = np.array([values[seed] for seed in (seeds if paired else values)], dtype=np.float64)
    b = np.array([others[seed] for seed in (seeds if paired else others)], dtype=np.float64)
    sd_a, sd_b = deviation(a), deviation(b)
    common = functools.partial(
        SigmaComparison, method, baseline, n=len(a), other_n=len(b), steadier=sd_a < sd_b
    )
    if sd_a == 0 or sd_b == 0:
        return common(ratio=None, interval=None, p=brown_forsythe(a, b))
    ratio = sd_a / sd_b
    if not paired:
        interval = _ratio_interval(ratio, len(a), len(b))
        return common(ratio=ratio, interval=interval, p=brown_forsythe(a, b))
    rho = min(max(float(np.corrcoef(a, b)[0, 1]), -MOST_ALIKE), MOST_ALIKE)
    p = float(uncorrelated((a - b)[None], (a + b)[None])[0])
    return common(ratio=ratio, interval=_paired_interval(ratio, rho, len(a)), p=p, rho=rho)


def sigmas_corrected(comparisons: Mapping[M, SigmaComparison]) -> dict[M, SigmaComparison]:
    """With p of a test that is one of all of these."""
    return {method: replace(c, tests=len(comparisons)) for method, c in comparisons.items()}


def brown_forsythe(a: np.ndarray, b: np.ndarray) -> float:
    """Two-sided p of equal spread; 1 where neither sample varies."""
    if not (np.ptp(a) > 0 or np.ptp(b) > 0):
        return 1.0
    from scipy.stats import levene  # a second to import, which studies of one method do not need

    with np.errstate(divide="ignore", invalid="ignore"):
        p = float(levene(a, b, center="median").pvalue)
    # all distances equal within both samples: a difference without noise, or none at all
    return p if math.isfinite(p) else float(np.isclose(np.ptp(a), np.ptp(b)))


def _paired_interval(ratio: float, rho: float, n: int) -> Interval:
    k = 1 + 2 * (1 - rho**2) * t_quantile(n - 2) ** 2 / (n - 2)
    low, high = (math.sqrt(k + sign * math.sqrt(k * k - 1)) for sign in (-1, 1))
    return Interval(ratio * low, ratio * high)


def _ratio_interval(ratio: float, n: int, other_n: int) -> Interval:
    low, high = _f_quantiles(n - 1, other_n - 1)
    return Interval(ratio / math.sqrt(high), ratio / math.sqrt(low))


@functools.cache
def _f_quantiles(a: int, b: int) -> tuple[float, float]:
    """The 2.5 % and 97.5 % quantiles of F(a, b)."""
    low, high = special.fdtri(a, b, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)
