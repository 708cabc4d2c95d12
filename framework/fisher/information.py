"""Fisher information of the Gaussians from one view.

With additive Gaussian noise on the pixels, F = J^T J: the sum over pixels **and channels** of outer
products of the pixel's derivatives (never the square of a summed gradient). Blocks are per Gaussian
(no cross terms between Gaussians), as in FisherRF and PUP-3DGS; unlike in the former, channels are
summed as squares. Units: intensity^2 per squared parameter, means in scene units; noise variance 1.
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
    """block [N, 6, 6]: (mean, log-scale). diagonal [N, 14]: mean 3, log-scale 3, quat 4, opacity
    logit 1, sh0 3. visible [N] bool: touched a pixel's box. All zeros for what the view misses. The
    first two share memory that is lent again once nobody holds either."""

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
    """Information of `camera`'s image on each Gaussian, exactly: one render, one second-moment
    pass, one pull-back (equation: `kernels.project.information`). mask [H, W]: pixels
    that it has not, at or below 0.5, tell nothing. The other arguments as `rasterize`. Raises
    UserError as `rasterize`, and for a mask of another shape or dtype."""
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
