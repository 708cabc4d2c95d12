"""The effective rank of Gaussians: needles, discs or balls (`metrics.coadaptation=true`)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from framework.compute import portable
from framework.metrics.values import RANK, Measurement, Missing, ViewMetrics


def effective_rank(log_scales: ArrayLike) -> float:
    """Mean over the Gaussians of exp(-sum_i q_i log q_i), q_i = s_i^2 / sum_j s_j^2.

    1 is a needle, 2 a disc, 3 a ball; NaN without a Gaussian. log_scales: [N, 3].

    Source: Roy & Vetterli 2007, "The effective rank"; of Gaussians' covariances, whose eigenvalues
    are s_i^2, Hyung et al. 2024, arXiv 2406.11672.
    """
    logs = 2 * np.asarray(log_scales, np.float64)
    if len(logs) == 0:
        return float("nan")
    squares = portable.exp(logs - logs.max(1, keepdims=True))  # up to a factor, the largest is 1
    shares = squares / squares.sum(1, keepdims=True)
    entropy = -(shares * portable.log(np.maximum(shares, np.finfo(np.float64).tiny))).sum(1)
    return float(portable.exp(entropy).mean())


def with_rank(metrics: Sequence[ViewMetrics], log_scales: ArrayLike) -> list[ViewMetrics]:
    """Add the effective rank of all Gaussians, log_scales [N, 3], to every view's metrics."""
    mean = effective_rank(log_scales)
    rank: Measurement = Missing("no Gaussian is left") if math.isnan(mean) else mean
    return [replace(view, also={**view.also, RANK: rank}) for view in metrics]
