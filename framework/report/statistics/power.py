"""What the tests of two standard deviations can find, by simulation.

Both samples are normal with the given ratio of standard deviations. The draws are fixed, so the
same question has the same answer everywhere.

- Brown and Forsythe (1974), of two independent samples, takes the distances from the median;
  scaling a sample scales its distances, so one set of draws serves all ratios:
  F = (N - 2) sum_g n_g (z_g - z)^2 / sum (z_gi - z_g)^2, refuted above the quantile of F(1, N - 2).
- Pitman and Morgan (1939), of pairs, is the t test of the correlation of their differences and
  sums, which is (q^2 - 1) / sqrt((q^2 + 1)^2 - 4 rho^2 q^2) for a ratio q and pairs correlated by
  rho. As a single outlier can make such a correlation, that of the ranks must agree.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from scipy import special

from framework.compute.rng import stream
from framework.report.statistics.estimates import SIGNIFICANCE

POWER = 0.8
DRAWS = 4_000  # samples of each method
VALUES = 80_000  # at most, of all samples of pairs together, whose ranks take most of the time
LARGEST_Z = 3.0  # of Fisher's transform: r = 0.995, which few seeds may have by chance
NO_SPREAD = 1e-6  # as a ratio


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
    """How often the paired test finds this ratio with n pairs that are correlated by rho."""
    mixed = math.sqrt(max((ratio**2 + 1) ** 2 - 4 * (rho * ratio) ** 2, 1e-12))
    c = (ratio**2 - 1) / mixed
    differences, rest = _pairs(n)
    return _found(differences, c * differences + math.sqrt(max(1 - c * c, 0.0)) * rest, tests)


def uncorrelated(differences: np.ndarray, sums: np.ndarray) -> np.ndarray:
    """Test pairs for correlation between differences and sums, for every row of [draws, n].

    Returns:
        [draws], two-sided p of no correlation: the larger one of that of the values and that of the
        ranks, each by t with n - 2 degrees of freedom.

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
    return np.maximum(*p_values)


def _found(differences: np.ndarray, sums: np.ndarray, tests: int) -> float:
    return float(np.mean(uncorrelated(differences, sums) < SIGNIFICANCE / tests))


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
