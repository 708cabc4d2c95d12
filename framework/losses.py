"""The photometric loss of 3DGS, (1 - w) L1 + w (1 - SSIM), as one differentiable kernel call.

Protocol: 11x11 Gaussian window (sigma 1.5), zero padding, mean over all pixels and channels. A mask
multiplies the render and the target, so nothing outside it leaks in; see `rasterize.photometric`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from framework.parallel import run_blocks
from framework.rasterize import photometric


@dataclass(frozen=True)
class Target:
    """What the loss needs of a target image, computed once per view.

    image: [3, H, W], multiplied by mask [H, W]. mean, variance: [3, H, W], its window statistics.
    """

    image: np.ndarray
    mask: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    @staticmethod
    def of(image: Tensor, mask: Tensor | None = None) -> Target:
        """From an image [3, H, W] in [0, 1] and an optional mask [H, W] in [0, 1]."""
        pixels = np.ascontiguousarray(image.detach().numpy(), np.float32)
        valid = np.ones(pixels.shape[1:], np.float32)
        if mask is not None:
            valid = np.ascontiguousarray(mask.detach().numpy(), np.float32)
            pixels = pixels * valid
        mean, variance = np.empty_like(pixels), np.empty_like(pixels)
        blurs = _blurs(pixels.shape)
        # the image is masked already: a mask of ones keeps a fractional one from counting twice
        run_blocks(photometric.blur_rows, pixels, pixels, np.ones_like(valid), blurs)
        run_blocks(photometric.statistics_rows, blurs, mean, variance)
        return Target(pixels, valid, mean, variance)


_buffers: dict[tuple[int, ...], np.ndarray] = {}


def _blurs(shape: tuple[int, ...]) -> np.ndarray:
    """Scratch for one image size, kept between steps; its padding rows stay zero."""
    if shape not in _buffers:
        channels, height, width = shape
        _buffers[shape] = np.zeros((6, channels, height + 10, width), np.float32)
    return _buffers[shape]


class _Photometric(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rgb: Tensor, target: Target, ssim_weight: float) -> Tensor:
        pixels = rgb.detach().contiguous().numpy()
        if pixels.dtype != np.float32 or pixels.shape != target.image.shape:
            raise ValueError(
                f"photometric_loss: expected float32 {target.image.shape}, got {pixels.dtype}"
                f" {pixels.shape}"
            )
        gradient = torch.empty(rgb.shape)
        blurs, sums = _blurs(pixels.shape), np.empty((2, *pixels.shape[:2]), np.float32)
        run_blocks(photometric.blur_rows, pixels, target.image, target.mask, blurs)
        run_blocks(photometric.ssim_rows, target.mean, target.variance, blurs, sums[0])
        run_blocks(
            photometric.gradient_rows,
            pixels,
            target.image,
            target.mask,
            blurs,
            np.float32(ssim_weight),
            np.float32(1 / pixels.size),
            sums[1],
            gradient.numpy(),
        )
        ctx.gradient = gradient
        ssim, l1 = sums.sum(axis=(1, 2), dtype=np.float64) / pixels.size
        return torch.tensor((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim), dtype=torch.float32)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Any:
        scale = float(grads[0])
        return ctx.gradient if scale == 1.0 else ctx.gradient * scale, None, None


def photometric_loss(rgb: Tensor, target: Target, ssim_weight: float = 0.2) -> Tensor:
    """(1 - w) mean |a - b| + w (1 - mean SSIM) of a render [3, H, W] float32; a scalar."""
    return _Photometric.apply(rgb, target, ssim_weight)  # type: ignore[no-any-return]
