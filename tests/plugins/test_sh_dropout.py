"""Dropout of SH bands, against numbers worked by hand and a mask within autograd's chain."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.kernels import rasterize
from framework.plugin import StepContext
from framework.types import Gaussians
from plugins.regularize.sh_dropout import ShDropout
from tests.plugins.fakes import context, wall_of_gaussians


def coloured(n: int, bands: int) -> Gaussians:
    """n Gaussians, the first `bands` of them with all 15 coefficients, 1 to 15 in each channel."""
    values = torch.arange(1.0, 16).view(1, 15, 1).expand(bands, 15, 3)
    return wall_of_gaussians(n).replace(sh0=torch.ones(n, 1, 3), shN=values.contiguous())


def at_step(step: int, degree: int, gaussians: Gaussians, seed: int = 0) -> StepContext:
    return replace(context(gaussians=gaussians, step=step, seed=seed), sh_degree=degree)


def squares(gaussians: Gaussians) -> dict[str, Tensor]:
    """The gradient of half the square of each Gaussian's sum of coefficients, by hand: the sum."""
    total = gaussians.sh0.sum(1, keepdim=True).clone()
    total[: len(gaussians.shN)] += gaussians.shN.sum(1, keepdim=True)
    return {"sh0": total, "shN": total[: len(gaussians.shN)].expand_as(gaussians.shN).contiguous()}


@pytest.mark.parametrize(
    ("step", "spared", "total"),
    [(0, 0, 1), (19, 0, 1), (20, 3, 7), (39, 3, 7), (40, 8, 37), (59, 8, 37)],
)
def test_dropped_bands_are_not_seen_and_get_no_gradient(step: int, spared: int, total: int) -> None:
    """The loss' residual by hand: 1 of sh0, with band 1 also 1 + 2 + 3, with band 2 also 4 to 8."""
    gaussians = coloured(4, 3)
    before = gaussians.clone()
    there = ShDropout(p=1.0).gradient(at_step(step, 3, gaussians), None, {}, squares)
    assert there is not None
    assert there["sh0"][:3].eq(total).all() and there["sh0"][3].eq(1).all()  # it has no bands
    assert there["shN"][:, :spared].eq(total).all() and there["shN"][:, spared:].eq(0).all()
    assert torch.equal(gaussians.shN, before.shN)


def test_it_is_the_gradient_through_a_masked_render() -> None:
    draws = torch.from_numpy(stream(5, "bands").random((400, 8, 3))).float()
    gaussians = wall_of_gaussians().replace(shN=draws - 0.5)
    ctx = at_step(25, 2, gaussians)
    view = ctx.views[0]

    def loss(of: Gaussians) -> Tensor:
        return (rasterize(of, view.camera, background=torch.zeros(3)).rgb - view.image).square()

    def at(of: Gaussians) -> dict[str, Tensor]:
        leaves = of.map(lambda t: t.clone().requires_grad_())
        loss(leaves).sum().backward()
        return {name: tensor.grad for name, tensor in leaves.items() if tensor.grad is not None}

    mask = torch.ones(400, 8, 1)
    mask[torch.from_numpy(ctx.rng("lacking").random(400)) < 0.2, 3:] = 0
    leaves = gaussians.map(lambda t: t.clone().requires_grad_())
    loss(leaves.replace(shN=leaves.shN * mask)).sum().backward()
    there = ShDropout().gradient(ctx, None, at(gaussians), at)
    assert there is not None and set(there) == {name for name, _ in gaussians.items()}
    for name, tensor in leaves.items():
        assert tensor.grad is not None
        assert torch.allclose(there[name], tensor.grad, rtol=1e-5, atol=1e-6), name
    assert not torch.allclose(there["sh0"], at(gaussians)["sh0"], rtol=1e-5, atol=1e-6)
