"""Binocular consistency: the gradient, where the camera is, and when."""

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.backends import build_rasterizer
from framework.compute.parallel import set_threads
from framework.geometry import moved_aside
from framework.kernels.binocular import binocular_gradient
from framework.train.depth_priors import AGREE, SHIFT, Beside, Binocular
from framework.train.epoch import Item
from framework.train.gradient import Rendering, view_gradient
from framework.types import Camera, Render, View
from tests.numerics.scenes import random_case

SIZES = [(37, 53), (1, 20), (20, 1), (1, 1), (3, 70)]
MOVES, TOLERANCE, WEIGHT = -3.7, 0.2, 0.3


def drawn(seed: int, height: int = 37, width: int = 53) -> tuple[Tensor, Tensor, Render, Tensor]:
    """alpha and depth, what the camera beside sees, and a photo; with holes in all."""
    draw = torch.Generator().manual_seed(seed)

    def rand(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=draw)

    def render() -> tuple[Tensor, Tensor]:
        alpha = rand(height, width).clamp(min=0.01)
        depth = alpha * (1 + 0.3 * rand(height, width))
        alpha[3:6, 4:9] = depth[3:6, 4:9] = 0
        return alpha, depth

    alpha, depth = render()
    shifted = Render(rand(3, height, width), *render(), torch.zeros(0))
    return alpha, depth, shifted, rand(3, height, width)


def loss(alpha: Tensor, depth: Tensor, rgb: Tensor, beside: Render, photo: Tensor) -> Tensor:
    """Pixel by pixel, for autograd; numbers as above."""
    height, width = alpha.shape
    total = rgb.new_zeros(())
    for y in range(height):
        for x in range(width):
            if float(alpha[y, x].detach()) <= 1e-6:
                continue
            disparity = alpha[y, x] / depth[y, x]
            there = x - MOVES * disparity
            if not 0 <= float(there.detach()) <= width - 1:
                continue
            left = min(int(there.detach()), max(width - 2, 0))
            right = min(left + 1, width - 1)
            if min(float(beside.alpha[y, left]), float(beside.alpha[y, right])) <= 1e-6:
                continue
            share = there - left
            near, far = (float(beside.alpha[y, i] / beside.depth[y, i]) for i in (left, right))
            apart = near + float(share.detach()) * (far - near) - float(disparity.detach())
            if abs(apart) >= TOLERANCE:
                continue
            seen = rgb[:, y, left] + share * (rgb[:, y, right] - rgb[:, y, left])
            total = total + WEIGHT * (seen - photo[:, y, x]).abs().sum()
    return total


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", ["numba", "reference"])
def test_the_gradient_is_autograd_s(name: str, size: tuple[int, int]) -> None:
    alpha, depth, shifted, photo = drawn(1, *size)
    wide = [t.double().requires_grad_() for t in (alpha, depth, shifted.rgb)]
    total = loss(*wide, shifted, photo)
    true = torch.autograd.grad(total, wide) if total.requires_grad else wide
    if not total.requires_grad:  # nothing counts
        true = [torch.zeros_like(t) for t in wide]
    who = build_rasterizer({"rasterizer": {"name": name}})
    target = who.losses().target(photo, None, who.device)
    actual = who.losses().binocular_gradient(
        alpha, depth, shifted, target, MOVES, TOLERANCE, WEIGHT
    )
    assert size[1] < 50 or all(t.abs().max() > 0 for t in true)
    for mine, exact in zip(actual, true, strict=True):
        error = (torch.as_tensor(mine) - exact).abs().max()
        assert error < 2e-5 * exact.abs().max() + 1e-9


def test_the_same_bits_on_any_threads() -> None:
    alpha, depth, shifted, photo = drawn(2, 101, 67)
    seen = tuple(t.numpy() for t in (shifted.rgb, shifted.alpha, shifted.depth))
    mask, numbers = np.ones((101, 67), np.float32), (MOVES, TOLERANCE, WEIGHT)
    actual = []
    for threads in (1, 2, 5):
        set_threads(threads)
        inputs = alpha.numpy(), depth.numpy(), seen, photo.numpy(), mask, *numbers
        actual.append([g.tobytes() for g in binocular_gradient(*inputs)])
    set_threads(0)
    assert actual[0] == actual[1] == actual[2]


@pytest.mark.parametrize("name", ["numba", "reference"])
def test_where_a_mask_has_no_photo_nothing_is_asked(name: str) -> None:
    alpha, depth, shifted, photo = drawn(3)
    who = build_rasterizer({"rasterizer": {"name": name}})
    mask = torch.zeros_like(alpha)
    mask[20:] = 1
    actual = who.losses().binocular_gradient(
        alpha, depth, shifted, who.losses().target(photo, mask, who.device), -3.7, 9.0, 0.3
    )
    for gradient in map(torch.as_tensor, actual):
        assert float(gradient[..., :20, :].abs().max()) == 0
        assert float(gradient[..., 20:, :].abs().max()) > 0


def test_the_step_s_gradient_is_that_of_both_renders() -> None:
    """What the term adds to the gradient in every parameter, with a penalty or without one, against
    autograd through two renders; the reported loss stays that of the photo."""
    case = random_case(6, n=60, margin=0.1)
    params = case.gaussians.map(lambda t: t.detach().requires_grad_())
    camera = case.camera
    photo = torch.rand(3, camera.height, camera.width, generator=torch.Generator().manual_seed(0))
    who = build_rasterizer({"rasterizer": {"name": "numba"}})
    shifted = Beside(
        moved_aside(camera, 0.05),
        moves=0.05 * float(camera.K[0, 0]),
        tolerance=TOLERANCE,
        weight=WEIGHT,
    )
    how = {"background": case.background, "opacity_factors": case.factors}
    item = Item(View("v", camera, photo), who.losses().target(photo, None, who.device))
    watched = Item(item.view, item.target, beside=shifted)

    def penalty(view: View, render: Render) -> Tensor:
        return 0 * render.rgb.sum()

    ours, other = (who.render(params, c, **how) for c in (camera, shifted.camera))
    actual = who.losses().binocular_gradient(
        ours.alpha.detach(),
        ours.depth.detach(),
        other,
        item.target,
        shifted.moves,
        TOLERANCE,
        WEIGHT,
    )
    assert all(float(torch.as_tensor(f).abs().max()) > 0 for f in actual)
    names = [name for name, _ in params.items()]
    exact = torch.autograd.grad(
        [ours.alpha, ours.depth, other.rgb],
        [t for _, t in params.items()],
        [torch.as_tensor(f) for f in actual],
        materialize_grads=True,
    )
    rendering = Rendering(rasterizer=who, **how)
    for asked in (None, penalty):
        without = view_gradient(params, item, "here", rendering, asked)
        plain = {name: gradient.clone() for name, gradient in without[1].items()}
        loss, gradients, _ = view_gradient(params, watched, "here", rendering, asked)
        assert loss == without[0]
        for name, true in zip(names, exact, strict=True):
            error = (gradients[name] - plain[name] - true).norm()
            assert error <= 1e-4 * (true.norm() + plain[name].norm()) + 1e-9, name


def view(focal: float = 80.0) -> View:
    K = torch.tensor([[focal, 0, 2], [0, focal, 1.5], [0, 0, 1]], dtype=torch.float64)
    return View("v", Camera(torch.eye(4, dtype=torch.float64), K, 4, 3), torch.zeros(3, 3, 4))


def test_when_and_where_the_camera_is() -> None:
    term = Binocular(weight=0.5, spacing=2.0, since=10, seed=0)
    asked = [step for step in range(30) if term.beside(view(), step)]
    assert asked == list(range(10, 30))
    places = []
    for step in asked:
        shifted = term.beside(view(), step)
        assert shifted is not None
        shift = float(shifted.camera.center[0])
        assert shifted.camera.center.tolist()[1:] == [0, 0] and abs(shift) <= SHIFT * 2
        assert shifted.moves == pytest.approx(80 * shift)
        assert shifted.tolerance == pytest.approx(AGREE / (80 * 2))
        assert shifted.weight == pytest.approx(0.5 / 36)
        places.append(shift)
    assert min(places) < 0 < max(places)
    other = Binocular(weight=0.5, spacing=2.0, since=10, seed=1).beside(view(), 10)
    assert other is not None and float(other.camera.center[0]) != places[0]
