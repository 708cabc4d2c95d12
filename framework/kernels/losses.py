"""The photometric loss of 3DGS, (1 - w) L1 + w (1 - SSIM), as one differentiable kernel call.

Protocol: 11x11 Gaussian window (sigma 1.5), zero padding, mean over all pixels and channels. A mask
multiplies the render and the target, so nothing outside it leaks in; see `photometric`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from framework.compute.parallel import run_blocks, threads
from framework.kernels import photometric
from framework.kernels.lending import ThreadsLender


@dataclass(frozen=True)
class Target:
    """What the loss needs of a target image, computed once per view.

    Attributes:
        image: [3, H, W], multiplied by mask [H, W].
        mean, variance: [3, H, S], statistics of its windows, in rows of whole vectors.
    """

    image: np.ndarray
    mask: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    @staticmethod
    def of(image: Tensor, mask: Tensor | None = None) -> Target:
        """Prepare an image [3, H, W] in [0, 1] with an optional mask [H, W] in [0, 1]."""
        pixels = np.ascontiguousarray(image.detach().numpy(), np.float32)
        ones = valid = _ones(*pixels.shape[1:])
        if mask is not None:
            valid = np.ascontiguousarray(mask.detach().numpy(), np.float32)
            pixels = pixels * valid
        shape = (*pixels.shape[:2], photometric.stride(pixels.shape[2]))
        mean, variance = np.empty(shape, np.float32), np.empty(shape, np.float32)
        # the image is masked already: a mask of ones keeps a fractional one from counting twice
        run_blocks(photometric.statistics, pixels, ones, mean, variance, blocks=_bands())
        return Target(pixels, valid, mean, variance)


@functools.lru_cache(maxsize=8)
def _ones(height: int, width: int) -> np.ndarray:
    """The mask [H, W] of all views without one; read only."""
    return np.ones((height, width), np.float32)


_lender = ThreadsLender()


def _bands() -> int:
    """Blocks of a parallel call, whole bands of each of three channels: three per thread, up to 12.

    A band computes some rows above and below it again, so more bands than the threads need cost
    time. The result does not depend on them, because rows are summed one by one.
    """
    return min(3 * threads(), 12)


def photometric_gradient(
    rgb: np.ndarray, target: Target, ssim_weight: float = 0.2, weight: float = 1.0
) -> tuple[float, np.ndarray]:
    """Compute `photometric_loss` times `weight` of a render [3, H, W] float32, and its gradient.

    The gradient is in a buffer that is reused once unreferenced.

    Raises:
        ValueError: for another shape or dtype.
    """
    if rgb.dtype != np.float32 or rgb.shape != target.image.shape:
        raise ValueError(
            f"photometric_loss: expected float32 {target.image.shape}, got {rgb.dtype} {rgb.shape}"
        )
    gradient, sums = _lender.lend([rgb.shape, (2, *rgb.shape[:2])])
    run_blocks(
        photometric.loss_and_gradient,
        rgb,
        target.image,
        target.mask,
        target.mean,
        target.variance,
        np.float32(ssim_weight),
        np.float32(1 / rgb.size),
        sums[0],
        sums[1],
        gradient,
        blocks=_bands(),
    )
    ssim, l1 = sums.sum(axis=(1, 2), dtype=np.float64) / rgb.size
    loss = np.float32((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim))
    if weight != 1:
        gradient *= np.float32(weight)
    return float(loss * np.float32(weight)), gradient


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: Tensor, target: Target, ssim_weight: float) -> Tensor:
        loss, gradient = photometric_gradient(
            rgb.detach().contiguous().numpy(), target, ssim_weight
        )
        ctx.gradient = torch.from_numpy(gradient)
        return torch.tensor(loss, dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Any:
        scale = float(grads[0])
        return ctx.gradient if scale == 1.0 else ctx.gradient * scale, None, None


def photometric_loss(rgb: Tensor, target: Target, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) mean |a - b| + w (1 - mean SSIM) of a render [3, H, W] float32; a scalar."""
    return _Photometric.apply(rgb, target, ssim_weight)  # type: ignore[no-any-return]
