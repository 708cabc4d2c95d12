"""Depth that is smooth where its photo is: the formula, by hand and by autograd in float64."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.backends.torch_loss import roughness_gradient as in_torch
from framework.compute.parallel import set_threads
from framework.geometry import mean_neighbour_distance
from framework.kernels.roughness import roughness_gradient
from framework.train.depth_priors import DepthSmoothness
from framework.train.epoch import Items
from framework.types import PSEUDO, Camera, View


def drawn(seed: int, height: int = 37, width: int = 53) -> tuple[Tensor, Tensor, Tensor]:
    """alpha, depth and weights, with a hole and a lone pixel that shows nothing."""
    draw = torch.Generator().manual_seed(seed)
    alpha = torch.rand(height, width, generator=draw).clamp(min=0.01)
    depth = alpha * (1 + 3 * torch.rand(height, width, generator=draw))
    alpha[3:6, 4:9] = depth[3:6, 4:9] = 0
    alpha[-1, -1] = depth[-1, -1] = 0
    weights = torch.rand(2, height, width, generator=draw)
    weights[0, :, -1] = weights[1, -1] = 0
    return alpha, depth, weights


def roughness(alpha: Tensor, depth: Tensor, weights: Tensor) -> Tensor:
    """The sum itself, for autograd."""
    shows = alpha > 1e-6
    disparity = alpha / torch.where(shows, depth, 1.0)
    across = weights[0, :, :-1] * disparity.diff(dim=1).abs()
    down = weights[1, :-1] * disparity.diff(dim=0).abs()
    pairs = shows[:, 1:] & shows[:, :-1], shows[1:] & shows[:-1]
    return across[pairs[0]].sum() + down[pairs[1]].sum()


@pytest.mark.parametrize("size", [(37, 53), (1, 20), (20, 1), (1, 1), (16, 16), (3, 70)])
def test_the_kernel_and_torch_have_autograd_s_gradient(size: tuple[int, int]) -> None:
    alpha, depth, weights = drawn(1, *size)
    wide = [t.double().requires_grad_() for t in (alpha, depth)]
    expected = torch.autograd.grad(roughness(*wide, weights), wide)
    scale = max(float(g.abs().max()) for g in expected) + 1e-30
    kernel = roughness_gradient(alpha.numpy(), depth.numpy(), weights.numpy())
    for actual, twin, true in zip(kernel, in_torch(alpha, depth, weights), expected, strict=True):
        assert np.abs(actual - true.numpy()).max() < 1e-6 * scale
        assert float((twin - true).abs().max()) < 1e-6 * scale


def test_the_same_bits_on_any_threads() -> None:
    inputs = [t.numpy() for t in drawn(2, 101, 67)]
    actual = []
    for threads in (1, 2, 5):
        set_threads(threads)
        actual.append([g.tobytes() for g in roughness_gradient(*inputs)])
    set_threads(0)
    assert actual[0] == actual[1] == actual[2]


def camera(x: float, focal: float = 80.0, size: tuple[int, int] = (4, 3)) -> Camera:
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[0, 3] = -x
    K = torch.tensor([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    return Camera(viewmat, K.double(), *size)


def test_weights_by_hand() -> None:
    """A photo of 4 x 3 that steps by (0.3, 0, 0) between its second and third column."""
    image = torch.zeros(3, 3, 4)
    image[0, :, 2:] = 0.3
    spacing = mean_neighbour_distance([camera(0), camera(0.5), camera(2.0)])
    assert spacing == pytest.approx((0.5 + 0.5 + 1.5) / 3)
    weights = DepthSmoothness(0.02, spacing).weights(View("v", camera(0), image))
    flat = 0.02 * spacing * 80 / 12
    edge = flat * math.exp(-10 * 0.1)
    right = torch.tensor([[flat, edge, flat, 0.0]] * 3)
    lower = torch.tensor([[flat] * 4] * 2 + [[0.0] * 4])
    torch.testing.assert_close(weights, torch.stack([right, lower]))


def test_it_is_kornia_s_inverse_depth_smoothness() -> None:
    """But for its means, which are over the steps and not over the pixels; its edges fade as
    exp(-|step|), so it gets a photo of ten times the contrast."""
    losses = pytest.importorskip("kornia.losses", reason="kornia is the oracle (extra: oracles)")
    height, width = 12, 17
    draw = torch.Generator().manual_seed(3)
    image = torch.rand(3, height, width, generator=draw)
    disparity = torch.rand(height, width, generator=draw) + 0.5
    view = View("v", camera(0, 80.0, (width, height)), image)
    weights = DepthSmoothness(1.0, 1.0).weights(view)

    def ours(axis: int) -> float:
        alone = torch.zeros_like(weights)
        alone[axis] = weights[axis]
        ones = torch.ones_like(disparity)
        return float(roughness(ones, 1 / disparity, alone)) / 80

    means = ours(0) * width / (width - 1) + ours(1) * height / (height - 1)
    theirs = losses.inverse_depth_smoothness_loss(disparity[None, None], 10 * image[None])
    assert means == pytest.approx(float(theirs), rel=1e-4)


def test_photos_are_smoothed_behind_and_pseudo_views_are_not() -> None:
    items = Items(smoothness=DepthSmoothness(0.01, 0.1))
    photo = View("v", camera(0), torch.rand(3, 3, 4))
    pseudo = View("p", camera(0), torch.rand(3, 3, 4), tags=(PSEUDO,))
    assert items.get(photo, 1).smoothing is not None
    assert items.get(pseudo, 1).smoothing is None
    assert Items().get(photo, 1).smoothing is None
