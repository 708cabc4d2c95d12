"""What the tests of two standard deviations can find, by simulation.

Both samples are normal with the given ratio of standard deviations. The draws are fixed, so the
same question has the same answer everywhere.

- Brown and Forsythe (1974), of two independent samples, takes the distances from the median;
  scaling a sample scales its distances, so one set of draws serves all ratios:
  F = (N - 2) sum_g n_g (z_g - z)^2 / sum (z_gi - z_g)^2, refuted above the quantile of F(1, N - 2).
- Pitman and Morgan (1939), of pairs, is the t test of the correlation of their differences and
  sums, which is (q^2 - 1) / sqrt((q^2 + 1)^2 - 4 rho^2 q^2) for a ratio q and pairs correlated by
  rho. Under normal errors it errs exactly as often as it should.
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
FEWEST, MOST_SEEDS = 3, 200  # of a method
SCANNED = 20  # below, a seed more may lower the power (odd samples hold their median): try each
DRAWS, FEWER_DRAWS = 20_000, 4_000  # samples of up to `SCANNED` values, of more
NO_SPREAD = 1e-6  # as a ratio


def power(ratio: float, n: int, other_n: int, tests: int = 1) -> float:
    """How often the test finds this ratio of standard deviations with n and other_n seeds, at 5 %
    shared by so many tests. ratio 1: how often it errs (its size)."""
    draws = min(_draws(n), _draws(other_n))
    (a, within_a), (b, within_b) = _distances(n, 0), _distances(other_n, 1)
    a, within = ratio * a[:draws], ratio**2 * within_a[:draws] + within_b[:draws]
    total = n + other_n
    middle = (n * a + other_n * b[:draws]) / total
    between = n * (a - middle) ** 2 + other_n * (b[:draws] - middle) ** 2
    limit = special.fdtri(1, total - 2, 1 - SIGNIFICANCE / tests)
    return float(np.mean((total - 2) * between > limit * within))


def size(n: int, other_n: int, tests: int = 1) -> float:
    """How often the test finds a difference where there is none."""
    return power(1.0, n, other_n, tests)


@functools.cache
def paired_power(ratio: float, rho: float, n: int, tests: int = 1) -> float:
    """How often the paired test finds this ratio with n pairs that are correlated by rho."""
    if n < FEWEST:
        return 0.0
    mixed = math.sqrt(max((ratio**2 + 1) ** 2 - 4 * (rho * ratio) ** 2, 1e-12))
    c = (ratio**2 - 1) / mixed
    x, xy, y = _products(n)
    rest = math.sqrt(max(1 - c * c, 0.0))
    variance = x * (c * c * x + 2 * c * rest * xy + rest * rest * y)
    r = (c * x + rest * xy) / np.sqrt(variance)
    limit = float(special.stdtrit(n - 2, 1 - SIGNIFICANCE / (2 * tests)))
    return float(np.mean(np.abs(r) * math.sqrt(n - 2) > limit * np.sqrt(np.maximum(1 - r * r, 0))))


@functools.cache
def heavy_size(n: int) -> float:
    """How often the paired test errs at 5 % where both errors of a pair, independent of each other,
    are heavy-tailed: t with 3 degrees of freedom."""
    draws = stream(0, f"pitman-morgan/heavy/{n}").standard_t(3, (2, _draws(n), n))
    a, b = draws - draws.mean(axis=2, keepdims=True)
    sums, differences = a + b, a - b
    r = (sums * differences).sum(1) / np.sqrt((sums**2).sum(1) * (differences**2).sum(1))
    limit = float(special.stdtrit(n - 2, 1 - SIGNIFICANCE / 2))
    return float(np.mean(np.abs(r) * math.sqrt(n - 2) > limit * np.sqrt(1 - r * r)))


def detectable(n: int, other_n: int, tests: int = 1, rho: float | None = None) -> float | None:
    """The ratio below 1 from which on the test finds a lower deviation with `POWER`; None where it
    would find none, however small. rho: of pairs, None of independent samples."""
    if rho is None:
        return _lowest(lambda ratio: power(ratio, n, other_n, tests))
    return _lowest(lambda ratio: paired_power(ratio, round(rho, 2), n, tests))


def seeds_needed(ratio: float, tests: int = 1, rho: float | None = None) -> int | None:
    """Seeds per method with which, and with one more, the test finds this ratio with `POWER`; None
    above `MOST_SEEDS`. rho: of pairs, None of independent samples."""
    lower = min(ratio, 1 / ratio)
    if rho is None:
        return _fewest(lambda n: power(lower, n, n, tests))
    return _fewest(lambda n: paired_power(lower, round(rho, 2), n, tests))


def _lowest(found: Callable[[float], float]) -> float | None:
    low, high = NO_SPREAD, 1.0
    if found(low) < POWER:
        return None
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if found(middle) >= POWER else (low, middle)
    return low


def _fewest(found: Callable[[int], float]) -> int | None:
    def enough(n: int) -> bool:
        return all(found(k) >= POWER for k in (n, n + 1))

    for n in range(FEWEST, SCANNED + 1):
        if enough(n):
            return n
    low, high = SCANNED, MOST_SEEDS
    if not enough(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if enough(middle) else (middle, high)
    return high


def _draws(n: int) -> int:
    return DRAWS if n <= SCANNED + 1 else FEWER_DRAWS


@functools.cache
def _distances(n: int, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """Of every simulated sample of n standard normal values: [draws] mean distance from its median,
    and [draws] sum of squares of the distances about that mean."""
    x = stream(0, f"brown-forsythe/{n}/{sample}").standard_normal((_draws(n), n))
    z = np.abs(x - np.median(x, axis=1, keepdims=True))
    mean = z.mean(axis=1)
    return mean, ((z - mean[:, None]) ** 2).sum(axis=1)


@functools.cache
def _products(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """[draws] centred sums of squares and of products of n pairs of independent normal values."""
    x, y = stream(0, f"pitman-morgan/{n}").standard_normal((2, _draws(n), n))
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    return (x * x).sum(1), (x * y).sum(1), (y * y).sum(1)
