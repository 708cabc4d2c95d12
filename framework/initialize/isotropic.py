"""Points to Gaussians: round, unrotated, of one opacity, coloured by the SH band 0 alone."""

import math

import numpy as np
import torch
from torch import Tensor

from framework.compute import portable
from framework.types import Gaussians

SH_C0 = 0.5 / math.sqrt(math.pi)  # Y_00; a colour is 0.5 + SH_C0 * sh0 + higher bands


def isotropic_gaussians(
    xyz: np.ndarray, rgb: np.ndarray, scales: np.ndarray, opacity: float, sh_degree: int
) -> Gaussians:
    """N Gaussians at xyz [N, 3] of colour rgb [N, 3] in [0, 1] and standard deviation scales [N]
    (scene units), all of `opacity` in (0, 1)."""
    n, n_bases = len(xyz), (sh_degree + 1) ** 2
    quats = torch.zeros(n, 4)
    quats[:, 0] = 1
    return Gaussians(
        means=_float32(xyz),
        quats=quats,
        log_scales=_float32(portable.log(scales))[:, None].repeat(1, 3),
        opacity_logits=torch.full((n,), math.log(opacity / (1 - opacity))),
        sh0=_float32((rgb - 0.5) / SH_C0)[:, None, :].contiguous(),
        shN=torch.zeros(n, n_bases - 1, 3),
    )


def _float32(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
