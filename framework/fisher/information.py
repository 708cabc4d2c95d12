"""Fisher information of the Gaussians from one view.

With additive Gaussian noise on the pixels, F = J^T J. It is the sum over pixels and channels of
outer products of the pixel's derivatives (never the square of a summed gradient). Blocks are per
Gaussian, without cross terms, as in FisherRF and PUP-3DGS. Unlike in FisherRF, channels are summed
as squares. Units: intensity^2 per squared parameter, means in scene units; noise variance 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.errors import require
from framework.kernels import give_back, rendered
from framework.types import Camera, Gaussians


@dataclass(frozen=True)
class FisherInformation:
    """Information of one view on N Gaussians; zeros for those that the view misses.

    block and diagonal share memory that is reused once neither is referenced.

    Attributes:
        block: [N, 6, 6], mean and log-scale.
        diagonal: [N, 14], mean 3, log-scale 3, quat 4, opacity logit 1, sh0 3.
        visible: [N] bool.
    """

    block: Tensor
    diagonal: Tensor
    visible: Tensor


def fisher_information(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Tensor | None = None,
    sh_degree: int | None = None,
    near: float = 0.01,
    mask: Tensor | None = None,
) -> FisherInformation:
    """Compute the exact information of `camera`'s image on each Gaussian.

    It takes one render, one pass for second moments and one pull-back (equation:
    `kernels.project.information`). Pixels of mask [H, W] at or below 0.5 do not count. The other
    arguments, and errors, are those of `rasterize`; a mask of another shape or dtype raises
    UserError.
    """
    n = len(gaussians)
    pixels = np.empty((0, 0), np.float32) if mask is None else counted(mask, camera).numpy()
    work, image, _ = rendered(gaussians, camera, background, sh_degree, near)
    work.blend_moments(image, pixels)
    block, diagonal = work.blocks.lend([(n, 6, 6), (n, 14)])
    work.information(block, diagonal)
    visible = torch.from_numpy(work.first[1:] > work.first[:-1])  # it has parts
    give_back(work)
    return FisherInformation(torch.from_numpy(block), torch.from_numpy(diagonal), visible)


def counted(mask: Tensor, camera: Camera) -> Tensor:
    """A mask that fits its camera, as the kernel reads it, which does not check bounds."""
    size = camera.height, camera.width
    require(
        mask.dtype == torch.float32 and tuple(mask.shape) == size,
        f"Fisher information: expected a float32 mask of shape {list(size)}, got {mask.dtype}"
        f" {list(mask.shape)}; scale it as its camera is",
    )
    return mask.detach().contiguous()
