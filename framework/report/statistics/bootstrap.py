"""A confidence interval of a standard deviation without the assumption of normal errors.

The chi-squared interval covers too rarely if errors have heavy tails. With t errors of 3 degrees of
freedom it covers 85 % with 5 seeds and 67 % with 20. Here log s is studentised by its leave-one-out
(jackknife) standard error. The quantiles of the studentised value come from resamples with
replacement (bootstrap-t, Efron 1981). This covers 97 % and 84 % in the same simulation, and 95 %
with 5 normal values; it is wider. The resamples depend only on the number of values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from framework.compute.rng import stream
from framework.report.statistics.estimates import CONFIDENCE, Interval, deviation

FEWEST = 5  # fewer values leave hardly any distinct resamples
RESAMPLES = 2000
DEGENERATE = 1e-6  # of the sample's deviation: a resample of (nearly) one value has no logarithm


def sd_interval(values: Sequence[float]) -> Interval | None:
    """None below `FEWEST` values, or where all of them, or all but one, are equal."""
    x = np.asarray(values, dtype=np.float64)
    n = len(x)
    if n < FEWEST:
        return None
    sd = deviation(x)
    if sd == 0:
        return None
    picks = stream(0, f"bootstrap/{n}").integers(0, n, (RESAMPLES, n))
    drawn = x[picks]
    sds = drawn.std(axis=1, ddof=1)
    errors = _standard_errors(drawn)
    usable = (sds > DEGENERATE * sd) & (errors > 0) & np.isfinite(errors)
    t = (np.log(sds[usable]) - math.log(sd)) / errors[usable]
    error = float(_standard_errors(x[None])[0])
    if not (error > 0 and math.isfinite(error)) or len(t) == 0:
        return None
    low, high = np.quantile(t, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return Interval(sd * math.exp(-float(high) * error), sd * math.exp(-float(low) * error))


def _standard_errors(samples: np.ndarray) -> np.ndarray:
    """[B] jackknife standard errors of log s of samples [B, n]; infinite or nan where leaving one
    value out leaves no spread."""
    n = samples.shape[1]
    distances = (samples - samples.mean(axis=1, keepdims=True)) ** 2
    # sum of squares without value i: S - d_i n / (n - 1)
    left = distances.sum(axis=1, keepdims=True) - distances * n / (n - 1)
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = 0.5 * np.log(np.maximum(left, 0.0) / (n - 2))
        spread = ((logs - logs.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    errors: np.ndarray = np.sqrt((n - 1) / n * spread)
    return errors
