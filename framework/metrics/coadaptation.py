"""How far Gaussians lean on each other: the co-adaptation score, and the mean of errors AVGE.

Chen et al. 2025 (arXiv 2508.12720): half of the Gaussians are left out at random, K times; where
all of these renders show something, their variance is what one Gaussian's place depends on the
others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from framework.metrics.values import AVERAGE, COADAPTATION, Measurement, Missing, ViewMetrics

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Render

RENDERS, DROPPED, SEEN = 5, 0.5, 0.8  # K; share left out; alpha from which all show something


def coadaptation(
    render: Callable[[Camera, Tensor], Render],
    n: int,
    cameras: Sequence[Camera],
    rng: np.random.Generator,
) -> float:
    """Mean over cameras of the mean over pixels and channels of the population variance of K
    renders without half of the `n` Gaussians; over pixels with alpha > 0.8 in all of them. NaN
    where no camera has one. Lower is better.

    render(camera, factors [n]): with opacities times the factors, 0 or 1.
    """
    import torch

    scores = []
    for camera in cameras:
        images, seen = [], None
        for _ in range(RENDERS):
            factors = torch.from_numpy(rng.random(n) >= DROPPED).float()
            found = render(camera, factors)
            images.append(found.rgb.double())
            solid = found.alpha > SEEN
            seen = solid if seen is None else seen & solid
        if seen is not None and seen.any():
            spread = torch.stack(images).var(0, unbiased=False)
            scores.append(float(spread[:, seen].mean()))
    return sum(scores) / len(scores) if scores else math.nan


def average_error(psnr: float, ssim: float, lpips: float) -> float:
    """AVGE (Niemeyer et al. 2022): the geometric mean of the mean squared error, the root of
    1 - SSIM and LPIPS."""
    parts = 10 ** (-psnr / 10), math.sqrt(1 - ssim), lpips
    return math.prod(parts) ** (1 / len(parts))


def with_average(metrics: Sequence[ViewMetrics]) -> list[ViewMetrics]:
    """With the mean of errors of every view, where LPIPS was measured; of other runs as it is."""
    if all(isinstance(one.lpips, Missing) for one in metrics):
        return list(metrics)
    return [replace(one, also={**one.also, AVERAGE: _average(one)}) for one in metrics]


def _average(one: ViewMetrics) -> Measurement:
    for part in (one.psnr, one.ssim, one.lpips):
        if isinstance(part, Missing):
            return part
    found = average_error(*(float(part) for part in (one.psnr, one.ssim, one.lpips)))  # type: ignore[arg-type]
    return found if math.isfinite(found) else Missing(f"{AVERAGE} gave no finite value")


def with_coadaptation(
    metrics: Sequence[ViewMetrics],
    render: Callable[[Camera, Tensor], Render],
    n: int,
    cameras: Sequence[Camera],
    rng: np.random.Generator,
) -> list[ViewMetrics]:
    """With the score of every view, in the order of their `cameras`; see `coadaptation`."""
    found = []
    for one, camera in zip(metrics, cameras, strict=True):
        value = coadaptation(render, n, [camera], rng)
        score: Measurement = value
        if math.isnan(value):
            score = Missing("no pixel shows something in all renders without half of the Gaussians")
        found.append(replace(one, also={**one.also, COADAPTATION: score}))
    return found
