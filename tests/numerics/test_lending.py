"""Memory that a step reuses has no other owner at that time."""

from __future__ import annotations

import gc
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.compute.parallel import run_together
from framework.kernels import rasterize
from framework.kernels.lending import Lender, ThreadsLender
from framework.kernels.losses import Target, photometric_loss
from tests.numerics.scenes import random_case

SHAPES = [(3, 5), (7,), (0, 0)]


def addresses(arrays: list[np.ndarray]) -> list[int]:
    return [array.ctypes.data for array in arrays]


def test_what_nobody_holds_is_lent_again() -> None:
    lender = Lender()
    first = addresses(lender.lend(SHAPES))  # an assertion would hold the arrays meanwhile
    second = addresses(lender.lend(SHAPES))
    assert first == second


@pytest.mark.parametrize(
    "held_by",
    [
        lambda array: array,
        lambda array: array[1:, 2],
        torch.from_numpy,
        lambda array: torch.from_numpy(array).detach()[0],
        lambda array: torch.from_numpy(array).reshape(-1).numpy(),
    ],
    ids=["array", "view", "tensor", "detached", "array of a tensor"],
)
def test_what_somebody_holds_is_not(held_by: Callable[[np.ndarray], object]) -> None:
    lender = Lender()
    held = held_by(lender.lend(SHAPES)[0])
    others = [lender.lend(SHAPES) for _ in range(20)]
    assert not any(np.shares_memory(np.asarray(held), array) for other in others for array in other)


def _step(pull: Tensor) -> tuple[int, tuple[Tensor, ...]]:
    """Address of the image, gradients."""
    case = random_case(3, n=40)
    camera, leaves = case.camera, case.gaussians.map(lambda t: t.requires_grad_())
    target = Target.of(torch.zeros(3, camera.height, camera.width))
    render = rasterize(leaves, camera, means2d_offset=pull)
    loss = photometric_loss(render.rgb, target)
    return render.rgb.data_ptr(), torch.autograd.grad(loss, [leaves.means, leaves.shN, pull])


def test_a_step_leaves_nothing_to_the_garbage_collector() -> None:
    pull = torch.zeros(40, 2, requires_grad=True)
    _step(pull)
    gc.collect()
    gc.disable()
    try:
        seen = []
        for _ in range(3):
            image, gradients = _step(pull)
            seen.append((image, *(g.data_ptr() for g in gradients)))
            del gradients
    finally:
        gc.enable()
    assert seen[0] == seen[1] == seen[2]


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


def test_what_a_plugin_may_keep_holds_no_image_and_no_other_gradient() -> None:
    pull = torch.zeros(40, 2, requires_grad=True)
    case = random_case(3, n=40)
    leaves = case.gaussians.map(lambda t: t.requires_grad_())
    seen = set()
    held = []
    for _ in range(6):
        render = rasterize(leaves, case.camera, means2d_offset=pull)
        gradients = torch.autograd.grad(render.rgb.sum(), [leaves.means, pull])
        seen.add((render.rgb.data_ptr(), gradients[0].data_ptr()))
        held += [render.radii, gradients[1]]
        del render, gradients
    assert len(seen) == 1
    assert len({tensor.data_ptr() for tensor in held}) == len(held)


def test_who_has_no_workspace_has_a_lender_for_each_thread() -> None:
    """Between finding a buffer free and lending it another thread may find it free too."""
    lender = ThreadsLender()
    first, second = run_together([lambda _: lender._own, lambda _: lender._own])
    assert first is not second
    (held,) = lender.lend([(8, 8)])
    place = held.ctypes.data
    assert lender.lend([(8, 8)])[0].ctypes.data != place
    del held
    assert lender.lend([(8, 8)])[0].ctypes.data == place
