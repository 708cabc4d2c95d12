"""Statistics on one number per run: its mean PSNR over the test views, in dB.

- sigma_PSNR: standard deviation (n - 1) over seeds of the mean over scenes. Its 95 % interval is
  sqrt((n - 1) s^2 / chi2) at the 97.5 % and 2.5 % quantiles (normal errors).
- Mean: t interval over seeds, two-sided t test of zero.

Several comparisons are corrected together (Bonferroni). Their intervals hold jointly with 95 %, and
one excludes zero exactly if p times their number is below 5 %.
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special  # without scipy.stats, which takes a second to import

CONFIDENCE = 0.95
SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class Interval:
    """A confidence interval at `CONFIDENCE`."""

    low: float
    high: float


@dataclass(frozen=True)
class Estimate:
    """A mean of n values.

    Attributes:
        sd: their standard deviation (n - 1), None below two, as are the intervals.
    """

    n: int
    mean: float
    sd: float | None

    def interval(self, tests: int = 1) -> Interval | None:
        """t interval of the mean that holds for so many estimates at once."""
        if self.sd is None:
            return None
        half = t_quantile(self.n - 1, tests) * self.sd / math.sqrt(self.n)
        return Interval(self.mean - half, self.mean + half)

    @property
    def ends(self) -> tuple[float, float]:
        """The ends of the bar around the mean: its interval, or the mean itself without one."""
        inside = self.interval() or Interval(self.mean, self.mean)
        return inside.low, inside.high

    @property
    def sd_interval(self) -> Interval | None:
        """The interval of the standard deviation."""
        if self.sd is None:
            return None
        levels = [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2]
        quantiles = special.chdtri(self.n - 1, levels).tolist()  # of chi2: 97.5 % and 2.5 %
        return Interval(*(self.sd * math.sqrt((self.n - 1) / quantile) for quantile in quantiles))

    @property
    def p(self) -> float | None:
        """Two-sided p of the t test that the true mean is zero."""
        if self.sd is None:
            return None
        if self.sd == 0:
            # the test has no scale then: equal bits everywhere, or one constant shift
            return 1.0 if self.mean == 0 else 0.0
        t = abs(self.mean) / (self.sd / math.sqrt(self.n))
        return float(2 * special.stdtr(self.n - 1, -t))


def estimate(values: Sequence[float]) -> Estimate:
    """Of one value or more."""
    x = np.asarray(values, dtype=np.float64)
    return Estimate(len(x), float(x.mean()), deviation(x) if len(x) > 1 else None)


def deviation(values: np.ndarray) -> float:
    """Standard deviation (n - 1); exactly 0 of equal values, whose mean may be rounded."""
    return float(values.std(ddof=1)) if np.ptp(values) > 0 else 0.0


@functools.cache
def t_quantile(freedom: int, tests: int = 1) -> float:
    """The t that a t variate exceeds in absolute value with probability 1 - `CONFIDENCE`, shared by
    so many tests."""
    return float(special.stdtrit(freedom, 1 - (1 - CONFIDENCE) / (2 * tests)))
