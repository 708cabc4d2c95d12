"""The statistics of a report, on one number per run: its mean PSNR over the test views, in dB.

- sigma_PSNR: standard deviation (n - 1) over seeds of the mean over scenes of that number; its
  95 % interval is sqrt((n - 1) s^2 / chi2) at the 97.5 % and 2.5 % quantiles (normal errors).
- Mean: t interval over seeds.
- Two methods: differences of runs paired by (scene, seed), t interval and two-sided t test; p
  values of several comparisons are corrected after Holm (1979). The interval is not corrected.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
class Spread:
    """n values: mean with interval, standard deviation (n - 1) with interval; None below two."""

    n: int
    mean: float
    mean_interval: Interval | None
    sd: float | None
    sd_interval: Interval | None


@dataclass(frozen=True)
class Comparison:
    """`method` minus `baseline` over n pairs; interval and p (two-sided) None below two pairs.
    p_holm: p corrected for all comparisons of the study."""

    method: str
    baseline: str
    n: int
    difference: float
    interval: Interval | None
    p: float | None
    p_holm: float | None = None

    @property
    def significant(self) -> bool:
        return self.p_holm is not None and self.p_holm < SIGNIFICANCE


def spread(values: Sequence[float]) -> Spread:
    """Mean and standard deviation with their intervals. Raises ValueError without values."""
    if len(values) == 0:
        raise ValueError("spread: expected at least one value")
    x = np.asarray(values, dtype=np.float64)
    if len(x) == 1:
        return Spread(1, float(x[0]), None, None, None)
    sd = float(x.std(ddof=1))
    return Spread(len(x), float(x.mean()), _mean_interval(x), sd, _sd_interval(sd, len(x)))


def compare(
    method: str, values: Mapping[Any, float], baseline: str, others: Mapping[Any, float]
) -> Comparison | None:
    """Paired comparison over the keys both have; None if there is no common key."""
    keys = sorted(values.keys() & others.keys())
    if not keys:
        return None
    d = np.array([values[key] - others[key] for key in keys], dtype=np.float64)
    if len(d) == 1:
        return Comparison(method, baseline, 1, float(d[0]), None, None)
    p = _paired_p(d)
    return Comparison(method, baseline, len(d), float(d.mean()), _mean_interval(d), p)


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm's step-down corrected p values, in the order given."""
    corrected, running = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(np.argsort(p_values, kind="stable")):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = running
    return corrected


@functools.cache
def t_quantile(freedom: int) -> float:
    """The t that a t variate exceeds in absolute value with probability 1 - `CONFIDENCE`."""
    return float(special.stdtrit(freedom, (1 + CONFIDENCE) / 2))


def _mean_interval(x: np.ndarray) -> Interval:
    half = t_quantile(len(x) - 1) * float(x.std(ddof=1)) / math.sqrt(len(x))
    return Interval(float(x.mean()) - half, float(x.mean()) + half)


def _sd_interval(sd: float, n: int) -> Interval:
    low, high = (sd * math.sqrt((n - 1) / quantile) for quantile in chi2_quantiles(n - 1))
    return Interval(low, high)


@functools.cache
def chi2_quantiles(freedom: float) -> tuple[float, float]:
    """The 97.5 % and 2.5 % quantiles of chi2."""
    high, low = special.chdtri(freedom, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(high), float(low)


def _paired_p(d: np.ndarray) -> float:
    sd = float(d.std(ddof=1))
    if sd == 0:
        # the test has no scale then: equal bits everywhere, or one constant shift
        return 1.0 if d[0] == 0 else 0.0
    t = abs(float(d.mean())) / (sd / math.sqrt(len(d)))
    return float(2 * special.stdtr(len(d) - 1, -t))
