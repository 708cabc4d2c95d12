"""How much Gaussians depend on each other, and how flat they are; and the mean error AVGE.

Chen et al. 2025 (arXiv 2508.12720): drop half of the Gaussians at random, K times. The score is the
variance of these renders, over the pixels that all of them cover. The effective rank distinguishes
needles, discs and balls.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from framework.compute import portable
from framework.metrics.values import (
    AVERAGE,
    COADAPTATION,
    RANK,
    Measurement,
    Missing,
    ViewMetrics,
)

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Render

RENDERS, DROPPED, COVERED = 5, 0.5, 0.8  # K; share of Gaussians dropped; least alpha of a pixel


def coadaptation(
    render: Callable[[Camera, Tensor], Render],
    n: int,
    camera: Camera,
    rng: np.random.Generator,
) -> float:
    """Mean over pixels and channels of the population variance of K renders without half of the
    `n` Gaussians; NaN where no pixel is covered in all of them. Lower is better.

    Args:
        render: renders a camera with the opacities multiplied by factors [n], 0 or 1.
        n: number of Gaussians.
        camera: of the view.
        rng: draws which Gaussians are dropped.
    """
    import torch

    renders = [
        render(camera, torch.from_numpy(rng.random(n) >= DROPPED).float()) for _ in range(RENDERS)
    ]
    covered = torch.stack([one.alpha > COVERED for one in renders]).all(0)
    variance = torch.stack([one.rgb.double() for one in renders]).var(0, unbiased=False)
    return float(variance[:, covered].mean())


def average_error(psnr: float, ssim: float, lpips: float) -> float:
    """AVGE: geometric mean of the mean squared error, sqrt(1 - SSIM) and LPIPS (Niemeyer 2022)."""
    parts = 10 ** (-psnr / 10), math.sqrt(1 - ssim), lpips
    return math.prod(parts) ** (1 / len(parts))


def with_average(metrics: Sequence[ViewMetrics]) -> list[ViewMetrics]:
    """Add AVGE to every view's metrics, unless LPIPS was not measured."""
    if all(isinstance(view.lpips, Missing) for view in metrics):
        return list(metrics)
    return [replace(view, also={**view.also, AVERAGE: _average(view)}) for view in metrics]


def _average(view: ViewMetrics) -> Measurement:
    parts = []
    for part in (view.psnr, view.ssim, view.lpips):
        if isinstance(part, Missing):
            return part
        parts.append(part)
    error = average_error(*parts)
    return error if math.isfinite(error) else Missing(f"{AVERAGE} gave no finite value")


def with_coadaptation(
    metrics: Sequence[ViewMetrics],
    render: Callable[[Camera, Tensor], Render],
    n: int,
    cameras: Sequence[Camera],
    rng: np.random.Generator,
) -> list[ViewMetrics]:
    """Add the score to the metrics of every view; `cameras` in the same order."""
    scored = []
    for view, camera in zip(metrics, cameras, strict=True):
        value = coadaptation(render, n, camera, rng)
        score: Measurement = value
        if math.isnan(value):
            score = Missing("no pixel shows something in all renders without half of the Gaussians")
        scored.append(replace(view, also={**view.also, COADAPTATION: score}))
    return scored


def effective_rank(log_scales: ArrayLike) -> float:
    """Mean over the Gaussians of exp(-sum_i q_i log q_i), q_i = s_i^2 / sum_j s_j^2.

    1 is a needle, 2 a disc, 3 a ball; NaN without a Gaussian.

    Source: Roy & Vetterli 2007, "The effective rank"; of Gaussians' covariances, whose eigenvalues
    are s_i^2, Hyung et al. 2024, arXiv 2406.11672.

    Args:
        log_scales: [N, 3].
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
