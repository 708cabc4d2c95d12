"""What the test of two standard deviations (Brown and Forsythe 1974) can find, by simulation.

Both samples are normal with the given ratio of standard deviations. The draws are fixed, so the
same question has the same answer everywhere. The test takes the distances from the median; scaling
a sample scales its distances, so one set of draws serves all ratios:
F = (N - 2) sum_g n_g (z_g - z)^2 / sum (z_gi - z_g)^2, refuted above the quantile of F(1, N - 2).
"""

from __future__ import annotations

import functools

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
def detectable(n: int, other_n: int, tests: int = 1) -> float | None:
    """The ratio below 1 from which on the test finds a lower deviation with `POWER`; None where it
    would find none, however small."""
    low, high = NO_SPREAD, 1.0
    if power(low, n, other_n, tests) < POWER:
        return None
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if power(middle, n, other_n, tests) >= POWER else (low, middle)
    return low


@functools.cache
def seeds_needed(ratio: float, tests: int = 1) -> int | None:
    """Seeds per method with which, and with one more, the test finds this ratio with `POWER`; None
    above `MOST_SEEDS`."""
    lower = min(ratio, 1 / ratio)

    def enough(n: int) -> bool:
        return all(power(lower, k, k, tests) >= POWER for k in (n, n + 1))

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
