"""Stability: do the standard deviations over seeds of two methods differ, and how many seeds would
show it?

Methods that share seeds are tested by Pitman and Morgan (1939). A seed changes both alike, so their
values are pairs. If the deviations are equal, differences and sums of the pairs are uncorrelated. A
t test checks this for the values. Ranks are tested too, because one outlier can cause a correlation
of values; up to seven of them exactly. p is the larger one. So fewer than five common seeds never
show a difference.

The interval of their ratio q is q sqrt(k -+ sqrt(k^2 - 1)), k = 1 + 2 (1 - r^2) t^2 / (n - 2), with
the correlation r within pairs. It contains the ratios that the test of values does not reject, for
normal errors.

Methods that share fewer than three seeds are tested by Brown and Forsythe (1974), an F test on the
absolute distances from the median. The interval is sd_a / sd_b over the quantiles of F(n_a - 1, n_b
- 1).

What these tests can detect is simulated. Both samples are normal with the given ratio of standard
deviations. The draws are fixed, so the same question has the same answer everywhere.

- Brown and Forsythe: scaling a sample scales its distances from the median, so one set of draws
  serves all ratios: F = (N - 2) sum_g n_g (z_g - z)^2 / sum (z_gi - z_g)^2, refuted above the
  quantile of F(1, N - 2).
- Pitman and Morgan: the correlation of differences and sums is (q^2 - 1) / sqrt((q^2 + 1)^2 - 4
  rho^2 q^2) for a ratio q and pairs correlated by rho.
"""

import functools
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy import special

from framework.compute.rng import stream
from framework.report.statistics.estimates import (
    CONFIDENCE,
    SIGNIFICANCE,
    Interval,
    deviation,
    t_quantile,
)
from framework.report.study.methods import Method

M = TypeVar("M")
POWER = 0.8
DRAWS = 4_000  # samples of each method
VALUES = 80_000  # at most, of all samples of pairs together, whose ranks take most of the time
LARGEST_Z = 3.0  # of Fisher's transform: r = 0.995, which few seeds may have by chance
NO_SPREAD = 1e-6  # as a ratio
EXACT = 7  # pairs, up to which all permutations of ranks are counted
ROUNDING = 1e-9  # of a correlation
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
    """Correct the p values for the number of comparisons."""
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
    ends = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
    low, high = special.fdtri(n - 1, other_n - 1, ends).tolist()
    return Interval(ratio / math.sqrt(high), ratio / math.sqrt(low))


def power(ratio: float, n: int, other_n: int, tests: int = 1) -> float:
    """Simulate how often the test finds this ratio of standard deviations with n and other_n seeds.

    The level of 5 % is shared by all tests.
    """
    (a, within_a), (b, within_b) = _distances(n, 0), _distances(other_n, 1)
    a, within = ratio * a, ratio**2 * within_a + within_b
    total = n + other_n
    middle = (n * a + other_n * b) / total
    between = n * (a - middle) ** 2 + other_n * (b - middle) ** 2
    limit = special.fdtri(1, total - 2, 1 - SIGNIFICANCE / tests)
    return float(np.mean((total - 2) * between > limit * within))


@functools.cache
def paired_power(ratio: float, rho: float, n: int, tests: int = 1) -> float:
    """Return the power of the paired test for this ratio, n pairs and correlation rho."""
    mixed = math.sqrt(max((ratio**2 + 1) ** 2 - 4 * (rho * ratio) ** 2, 1e-12))
    c = (ratio**2 - 1) / mixed
    differences, rest = _pairs(n)
    sums = c * differences + math.sqrt(max(1 - c * c, 0.0)) * rest
    return float(np.mean(uncorrelated(differences, sums) < SIGNIFICANCE / tests))


def uncorrelated(differences: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """Test pairs for correlation between differences and sums, for every row of [draws, n].

    Returns:
        [draws], two-sided p of no correlation: the larger one of that of the values and that of the
        ranks, each by t with n - 2 degrees of freedom; that of few ranks over all permutations.

    Source:
        Pitman 1939 and Morgan 1939; McCulloch 1987.
    """
    n = differences.shape[1]
    ranks = [x.argsort(axis=1).argsort(axis=1).astype(np.float64) for x in (differences, sums)]
    p_values = []
    for x, y in ((differences, sums), ranks):
        x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
        size = np.sqrt((x * x).sum(1) * (y * y).sum(1))
        r = (x * y).sum(1) / np.maximum(size, 1e-150)  # equal ones are not correlated
        t = np.abs(r) * np.sqrt((n - 2) / np.maximum(1 - r * r, 1e-300))
        p_values.append(2 * special.stdtr(n - 2, -t))
    if n <= EXACT:
        every = _rank_correlations(n)
        p_values[1] = 1 - np.searchsorted(every, np.abs(r) - ROUNDING) / len(every)
    return np.maximum(*p_values)


@functools.cache
def _rank_correlations(n: int) -> np.ndarray:
    """[n!], the absolute correlations of n ranks with all of their permutations, ascending."""
    ranks = np.arange(n) - (n - 1) / 2
    every = np.array(list(itertools.permutations(ranks)))
    return np.sort(np.abs(every @ ranks) / (ranks @ ranks))


@functools.cache
def detectable(n: int, other_n: int, tests: int = 1, rho: float | None = None) -> float | None:
    """The ratio below 1 from which on the test finds a lower deviation with `POWER`; None where it
    would find none, however small.

    Args:
        rho: of pairs, None of independent samples.
    """
    if rho is None:
        return _lowest(lambda ratio: power(ratio, n, other_n, tests))
    return _lowest(lambda ratio: paired_power(ratio, _near(rho), n, tests))


def _near(rho: float) -> float:
    """Round a correlation so that questions can share a simulation.

    Steps are in its Fisher transform and become smaller near 1. They never reach 1, where pairs
    would not differ by chance.
    """
    return math.tanh(round(min(max(math.atanh(rho), -LARGEST_Z), LARGEST_Z), 1))


def _lowest(chance: Callable[[float], float]) -> float | None:
    low, high = NO_SPREAD, 1.0
    if chance(low) < POWER:
        return None
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if chance(middle) >= POWER else (low, middle)
    return low


@functools.cache
def _distances(n: int, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """For simulated samples of n standard normal values, compute the mean distance from the
    median [draws] and the sum of squares of the distances about that mean [draws].
    """
    x = stream(0, f"brown-forsythe/{n}/{sample}").standard_normal((DRAWS, n))
    z = np.abs(x - np.median(x, axis=1, keepdims=True))
    mean = z.mean(axis=1)
    return mean, ((z - mean[:, None]) ** 2).sum(axis=1)


@functools.cache
def _pairs(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Twice [draws, n] independent standard normal values."""
    draws = min(DRAWS, VALUES // n)
    x, y = stream(0, f"pitman-morgan/{n}").standard_normal((2, draws, n))
    return x, y
