"""Memory that a step reuses has no other owner at that time."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from framework.kernels import rasterize
from framework.kernels.losses import Target, photometric_loss
from tests.numerics.scenes import random_case


def _step(pull: Tensor) -> tuple[int, tuple[Tensor, ...]]:
    """Address of the image, gradients."""
    case = random_case(3, n=40)
    camera, leaves = case.camera, case.gaussians.map(lambda t: t.requires_grad_())
    target = Target.of(torch.zeros(3, camera.height, camera.width))
    render = rasterize(leaves, camera, means2d_offset=pull)
    loss = photometric_loss(render.rgb, target)
    return render.rgb.data_ptr(), torch.autograd.grad(loss, [leaves.means, leaves.shN, pull])


def test_gradients_that_are_kept_do_not_change() -> None:
    pull = torch.zeros(40, 2, requires_grad=True)
    _, kept = _step(pull)
    copies = [gradient.clone() for gradient in kept]
    for _ in range(6):
        _step(pull + 0.5)
    assert all(torch.equal(a, b) for a, b in zip(kept, copies, strict=True))


@pytest.mark.parametrize("part", ["rgb", "alpha", "depth"])
def test_a_render_that_is_changed_in_place_has_no_gradient(part: str) -> None:
    """It is what the gradient is computed from."""
    case = random_case(3, n=40)
    leaves = case.gaussians.map(lambda t: t.requires_grad_())
    render = rasterize(leaves, case.camera)
    getattr(render, part).mul_(0.5)
    loss = render.rgb.sum() + render.alpha.sum() + render.depth.sum()
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        torch.autograd.grad(loss, [leaves.means])
