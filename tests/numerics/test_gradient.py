"""The gradient that training takes directly is that of autograd, bit for bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from framework.epoch import Items
from framework.errors import UserError
from framework.gradient import ViewGradient, view_gradient
from framework.guard import Diverged
from framework.rasterize import render_gradient
from framework.types import View
from tests.numerics.scenes import crowded_case, random_case


def bits(found: ViewGradient) -> list[Any]:
    loss, gradients, stats = found
    tensors = [*gradients.values(), stats.means2d_grad, stats.radii]
    return [loss, list(gradients), *(tensor.numpy().tobytes() for tensor in tensors)]


@pytest.mark.parametrize("weight", [1.0, 0.3])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_direct_is_autograd(seed: int, masked: bool, weight: float) -> None:
    case = random_case(seed) if seed < 3 else crowded_case(seed)
    draw = torch.Generator().manual_seed(seed)
    size = (case.camera.height, case.camera.width)
    mask = (torch.rand(size, generator=draw) > 0.3).float() if masked else None
    image = torch.rand((3, *size), generator=draw)
    view = View("v", case.camera, image, mask=mask, weight=weight)
    item, params = Items().get(view, 1), case.gaussians.map(lambda t: t.requires_grad_())
    options: dict[str, Any] = {"background": case.background, "near": 0.2}
    options |= {"sh_degree": case.sh_degree, "opacity_factors": case.factors}
    direct = view_gradient(params, item, "here", 0.2, **options)
    by_autograd = view_gradient(params, item, "here", 0.2, lambda view, render: 0.0, **options)
    assert bits(direct) == bits(by_autograd)
    assert direct[1]["means"].abs().sum() > 0
    assert (direct[2].height, direct[2].width) == size


@pytest.mark.parametrize("penalty", [None, lambda view, render: 0.0])
def test_a_loss_that_is_not_finite_is_told_and_the_next_is_as_ever(penalty: Any) -> None:
    case = random_case(1)
    image = torch.rand((3, case.camera.height, case.camera.width))
    item = Items().get(View("v", case.camera, image), 1)
    broken = Items().get(View("v", case.camera, torch.full_like(image, torch.nan)), 1)
    params = case.gaussians.map(lambda t: t.requires_grad_())
    before = bits(view_gradient(params, item, "here", 0.2, penalty))
    with pytest.raises(Diverged, match="here: expected a finite loss, got nan"):
        view_gradient(params, broken, "here", 0.2, penalty)
    assert bits(view_gradient(params, item, "here", 0.2, penalty)) == before


@pytest.mark.parametrize("change", [lambda rgb: rgb[:, :-1], lambda rgb: rgb.astype(np.float64)])
def test_a_gradient_that_does_not_fit_is_refused(change: Any) -> None:
    """Kernels check no bounds, and compile anew for another type."""
    case = random_case(1)
    with pytest.raises(UserError, match=r"expected a float32 gradient of shape \[3, 47, 33\]"):
        render_gradient(case.gaussians, case.camera, change)
