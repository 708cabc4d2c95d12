"""The losses of `torch_loss` by the kernels: the same functions, on arrays of the CPU."""

from typing import Any

import numpy as np
from torch import Tensor

from framework.kernels import binocular, roughness
from framework.kernels.losses import Target
from framework.kernels.losses import photometric_gradient as loss_gradient  # noqa: F401
from framework.kernels.losses import photometric_loss as photometric_loss
from framework.types import Render


def target(image: Tensor, mask: Tensor | None, device: str) -> Target:
    return Target.of(image, mask)


def roughness_gradient(alpha: Any, depth: Any, weights: Tensor) -> tuple[Any, Any]:
    return roughness.roughness_gradient(np.asarray(alpha), np.asarray(depth), weights.numpy())


def binocular_gradient(
    alpha: Any, depth: Any, beside: Render, target: Target, *numbers: float
) -> tuple[Any, Any, Any]:
    seen = tuple(t.detach().numpy() for t in (beside.rgb, beside.alpha, beside.depth))
    of_photo = np.asarray(alpha), np.asarray(depth)
    return binocular.binocular_gradient(*of_photo, seen, target.image, target.mask, *numbers)
