"""Fisher information of the Gaussians from one view.

With additive Gaussian noise on the pixels, F = J^T J: the sum over pixels **and channels** of outer
products of the pixel's derivatives, never the square of a summed gradient. Blocks are per Gaussian,
without cross terms between Gaussians, as in FisherRF and PUP-3DGS. Unlike FisherRF, channels are
summed as squares. The unit is intensity^2 per squared parameter, with means in scene units and a
noise variance of 1.
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.errors import require
from framework.kernels import give_back, rendered
from framework.types import Camera, Gaussians


@dataclass(frozen=True)
class FisherInformation:
    """The information of one view on every Gaussian, zero for those it does not see.

    `block` and `diagonal` share a buffer that is reused once neither is referenced.

    Attributes:
        block: [N, 6, 6], on (mean, log-scale).
        diagonal: [N, 14], on mean 3, log-scale 3, quat 4, opacity logit 1, sh0 3.
        visible: [N] bool, whether the Gaussian's box contains a pixel.
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
    """Compute the exact information of a camera's image on each Gaussian.

    It takes one render, one pass for second moments and one pull-back;
    `kernels.project.fisher` has the equation.

    Args:
        gaussians: the N Gaussians.
        camera: the view.
        background: [3], default black.
        sh_degree: active degree, at most the stored one (default).
        near: Gaussians with a smaller z are culled.
        mask: [H, W] float32; pixels at or below 0.5 do not count.

    Raises:
        UserError: for wrong shapes and dtypes.
    """
    n, size = len(gaussians), (camera.height, camera.width)
    pixels = np.empty((0, 0), np.float32)
    if mask is not None:  # the kernel does not check bounds
        require(
            mask.dtype == torch.float32 and tuple(mask.shape) == size,
            f"Fisher information: expected a float32 mask of shape {list(size)}, got {mask.dtype}"
            f" {list(mask.shape)}; scale it as its camera is",
        )
        pixels = mask.detach().contiguous().numpy()
    work, image, _ = rendered(gaussians, camera, background, sh_degree, near)
    work.blend_moments(image, pixels)
    block, diagonal = work.blocks.lend([(n, 6, 6), (n, 14)])
    work.information(block, diagonal)
    visible = torch.from_numpy(work.first[1:] > work.first[:-1])  # it has parts
    give_back(work)
    return FisherInformation(torch.from_numpy(block), torch.from_numpy(diagonal), visible)
