"""The break-down point: the strength of a stress at which a method stops helping.

At every tested strength there is one difference `method - baseline` in dB per seed, with the same
seeds at all strengths. Each seed's difference is interpolated linearly between neighbouring
strengths. The break-down point is where the mean of these curves first falls to zero, from the
weakest stress to the strongest.

Its interval contains every strength at which a paired t test (n - 1 degrees of freedom) does not
reject a mean difference of zero. If errors are normal and the truth is linear between the tested
strengths, it covers a zero of the truth with the stated probability (Fieller 1954). The interval is
the hull of these strengths, so it is wider if they are not connected.
"""

import math
from dataclasses import dataclass

import numpy as np

from framework.report.statistics.estimates import Interval, estimate, t_quantile


@dataclass(frozen=True)
class Breakdown:
    """The mean difference from the weakest to the strongest tested stress.

    Attributes:
        helps: it is above zero at some tested strength.
        starts: where it first rises above zero; None if it begins above or stays below.
        stops: the break-down point; None if it does not fall to zero.
        interval: hull of the strengths where zero is not rejected; None if it is rejected
            everywhere or there are fewer than two seeds.
        n: number of seeds.
        signs: at every tested strength 1 or -1 if the mean differs significantly from zero
            (Bonferroni-corrected over all comparisons of a study), else 0.
    """

    helps: bool
    starts: float | None
    stops: float | None
    interval: Interval | None
    n: int
    signs: tuple[int, ...]

    @property
    def significant(self) -> bool:
        return any(self.signs)

    @property
    def gains(self) -> bool:
        return 1 in self.signs


def break_down(strengths: np.ndarray, gains: np.ndarray, tests: int | None = None) -> Breakdown:
    """strengths: [L] in the order of growing stress (rising or falling numbers), L >= 2. gains:
    [L, n] dB, method minus baseline, one column per seed. tests: see `gains_of_levels`."""
    mean, n = gains.mean(axis=1), gains.shape[1]
    starts, stops = _zeros(strengths, mean)
    helps = bool((mean > 0).any())
    signs = tuple(_sign(row) for row in gains_of_levels(gains, tests))
    if n < 2:
        return Breakdown(helps, starts, stops, None, n, signs)
    doubtful = _doubtful(strengths, gains)
    interval = Interval(min(doubtful), max(doubtful)) if doubtful else None
    return Breakdown(helps, starts, stops, interval, n, signs)


def gains_of_levels(
    gains: np.ndarray, tests: int | None = None
) -> list[tuple[float, Interval | None]]:
    """Compute the mean gain at every strength, with its interval.

    Args:
        gains: [L, n], L strengths and n seeds.
        tests: how many comparisons the intervals hold for simultaneously; None for these strengths.

    Returns:
        One estimate per strength; None with fewer than two seeds.
    """
    estimates = [estimate(list(row)) for row in gains]
    return [(e.mean, e.interval(tests or len(estimates))) for e in estimates]


def _sign(gain: tuple[float, Interval | None]) -> int:
    mean, interval = gain
    if interval is None or interval.low <= 0 <= interval.high:
        return 0
    return 1 if mean > 0 else -1


def _zeros(strengths: np.ndarray, mean: np.ndarray) -> tuple[float | None, float | None]:
    """The first rise above zero (unless it begins there) and the first fall to it."""
    starts = stops = None
    for k in range(len(mean) - 1):
        rises, falls = mean[k] <= 0 < mean[k + 1], mean[k] > 0 >= mean[k + 1]
        if not (rises or falls):
            continue
        share = mean[k] / (mean[k] - mean[k + 1])
        zero = float(strengths[k] + share * (strengths[k + 1] - strengths[k]))
        if rises and starts is None and stops is None:
            starts = zero
        if falls and stops is None:
            stops = zero
    return starts, stops


def _doubtful(strengths: np.ndarray, gains: np.ndarray) -> list[float]:
    """Compute the ends of the pieces in which zero is not rejected.

    On a segment with seeds u + w v, w in [0, 1], mean(u + w v)^2 <= t^2 / n var(u + w v) is
    quadratic in w.
    """
    n = gains.shape[1]
    limit = t_quantile(n - 1) ** 2 / n
    ends: list[float] = []
    for k in range(len(strengths) - 1):
        u, v = gains[k], gains[k + 1] - gains[k]
        cov = np.cov(u, v).tolist()
        a = float(v.mean()) ** 2 - limit * cov[1][1]
        b = 2 * (float(u.mean() * v.mean()) - limit * cov[0][1])
        c = float(u.mean()) ** 2 - limit * cov[0][0]
        inside = [w for w, value in ((0.0, c), (1.0, a + b + c)) if value <= 0]
        shares = [*inside, *(w for w in _roots(a, b, c) if 0 <= w <= 1)]
        ends += [float(strengths[k] + w * (strengths[k + 1] - strengths[k])) for w in shares]
    return ends


def _roots(a: float, b: float, c: float) -> list[float]:
    """Real zeros of a w^2 + b w + c, without cancellation."""
    inner = b * b - 4 * a * c
    if inner < 0:
        return []
    q = -0.5 * (b + math.copysign(math.sqrt(inner), b))
    return [top / bottom for top, bottom in ((q, a), (c, q)) if bottom != 0]
