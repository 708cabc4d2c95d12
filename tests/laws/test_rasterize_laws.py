"""What must hold for every scene: of the kernels in float32, of the reference in float64."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from framework.compute.rng import stream
from framework.errors import UserError
from framework.kernels import rasterize
from framework.kernels.reference import rasterize_reference
from framework.types import Camera, Gaussians, Render
from tests.numerics.scenes import Case, random_case

seeds = st.integers(min_value=0, max_value=10**6)
few = settings(derandomize=True, max_examples=8, deadline=None, database=None)


@dataclass(frozen=True)
class Rasterizer:
    """An implementation with its dtype and the error it may make in [0, 1] images."""

    call: Callable[..., Render]
    dtype: torch.dtype
    tolerance: float

    def __call__(self, gaussians: Gaussians, camera: Camera, **options: Tensor | float) -> Render:
        return self.call(gaussians.map(lambda t: t.to(self.dtype)), camera, **options)

    def close(self, actual: Tensor, expected: Tensor) -> None:
        torch.testing.assert_close(
            actual.to(self.dtype), expected.to(self.dtype), rtol=0, atol=self.tolerance
        )


KERNEL = Rasterizer(rasterize, torch.float32, 2e-5)
REFERENCE = Rasterizer(rasterize_reference, torch.float64, 1e-9)
either = pytest.mark.parametrize("render", [KERNEL, REFERENCE], ids=["kernel", "reference"])


def _flat(case: Case) -> Gaussians:
    """The case's Gaussians with one colour each, from everywhere."""
    return case.gaussians.replace(shN=case.gaussians.shN[:, :0])


@either
@given(seed=seeds)
@few
def test_order_of_storage_does_not_matter(render: Rasterizer, seed: int) -> None:
    case = random_case(seed)
    order = torch.from_numpy(stream(seed, "test-permutation").permutation(len(case.gaussians)))
    plain, shuffled = (
        render(case.gaussians, case.camera),
        render(case.gaussians[order], case.camera),
    )
    assert torch.equal(plain.radii[order], shuffled.radii)
    for name in ("rgb", "alpha", "depth"):
        render.close(getattr(shuffled, name), getattr(plain, name))
        if render is KERNEL:
            assert torch.equal(getattr(shuffled, name), getattr(plain, name)), name


@either
@given(seed=seeds)
@few
def test_weights_and_transmittance_sum_to_one(render: Rasterizer, seed: int) -> None:
    """White Gaussians on white are white; on black their image is alpha."""
    case = random_case(seed)
    sh0 = torch.full(case.gaussians.sh0.shape, math.sqrt(math.pi), dtype=render.dtype)
    white = _flat(case).replace(sh0=sh0)
    seen = render(white, case.camera, background=torch.ones(3))
    render.close(seen.rgb, torch.ones_like(seen.rgb))
    on_black = render(white, case.camera)
    render.close(on_black.rgb, on_black.alpha.expand(3, -1, -1))


def _is_background(seen: Render, case: Case) -> bool:
    expected = case.background[:, None, None].to(seen.rgb.dtype).expand_as(seen.rgb)
    empty = not (seen.alpha.any() or seen.depth.any() or seen.radii.any())
    return empty and torch.equal(seen.rgb, expected)


@either
@given(seed=seeds)
@few
def test_what_lies_behind_the_camera_is_not_seen(render: Rasterizer, seed: int) -> None:
    case = random_case(seed)
    viewmat = case.camera.viewmat
    points = case.gaussians.means.double() @ viewmat[:3, :3].T + viewmat[:3, 3]
    points[:, 2] = -points[:, 2].abs()
    means = (points - viewmat[:3, 3]) @ viewmat[:3, :3]
    gaussians = case.gaussians.map(lambda t: t.to(render.dtype).requires_grad_())
    behind = gaussians.replace(means=means.to(render.dtype).requires_grad_())
    seen = render.call(behind, case.camera, background=case.background)
    assert _is_background(seen, case)
    (seen.rgb.sum() + seen.depth.sum()).backward()
    for name, tensor in behind.items():
        assert tensor.grad is None or not tensor.grad.any(), name


def test_needles_near_the_camera_stay_finite() -> None:
    """Their projected covariance has a determinant that cancels if computed naively in float32."""
    rng = stream(0, "needles")
    n = 200

    def tensor(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values.astype(np.float32)).requires_grad_()

    means = np.concatenate([rng.normal(0, 0.05, (n, 2)), rng.uniform(0.1, 0.4, (n, 1))], 1)
    log_scales = np.log(10 ** rng.uniform([-5, -5, 0], [-3, -3, 1.2], (n, 3)))
    needles = Gaussians(
        tensor(means),
        tensor(rng.normal(size=(n, 4))),
        tensor(log_scales),
        tensor(np.zeros(n)),
        tensor(rng.normal(size=(n, 1, 3))),
        tensor(np.zeros((n, 0, 3))),
    )
    K = torch.tensor([[400.0, 0, 64], [0, 400.0, 48], [0, 0, 1]])
    render = rasterize(needles, Camera(torch.eye(4), K, 128, 96))
    assert ((render.alpha >= 0) & (render.alpha <= 1)).all()
    (render.rgb.sum() + render.depth.sum()).backward()
    for name, parameter in needles.items():
        assert parameter.grad is not None and torch.isfinite(parameter.grad).all(), name


def test_more_tiles_than_can_be_counted_are_refused() -> None:
    """Their lists would be addressed by a negative number."""
    n, size = 140_000, 2000
    means = torch.tensor([[0.0, 0, 1]]).repeat(n, 1)
    vast = Gaussians(
        means,
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.full((n, 3), 3.0),
        torch.full((n,), 5.0),
        torch.zeros(n, 1, 3),
        torch.zeros(0, 0, 3),
    )
    K = torch.tensor([[1000.0, 0, size / 2], [0, 1000, size / 2], [0, 0, 1]])
    with pytest.raises(UserError, match="at most 2147483647 tiles, got 2187500000"):
        rasterize(vast, Camera(torch.eye(4), K, size, size))


def test_wrong_shapes_are_refused() -> None:
    """The kernels read without checking bounds."""
    n = 5
    gaussians = Gaussians(
        torch.rand(n, 3),
        torch.rand(n, 4),
        torch.zeros(n, 3),
        torch.zeros(n),
        torch.zeros(n, 1, 3),
        torch.zeros(n, 0, 3),
    )
    camera = Camera(torch.eye(4), torch.eye(3), 8, 8)
    with pytest.raises(UserError, match=r"opacity_factors of shape \[5\] .* got \[4\]"):
        rasterize(gaussians, camera, opacity_factors=torch.ones(4))
    with pytest.raises(UserError, match=r"background of shape \[3\]"):
        rasterize(gaussians, camera, background=torch.zeros(1))
    with pytest.raises(UserError, match="sh0"):
        rasterize(gaussians.replace(sh0=torch.zeros(n, 3)), camera)


def test_a_render_without_depth_has_the_same_colours_and_gradients() -> None:
    """Leaving the depth out is a matter of time alone."""
    case = random_case(6)
    gaussians, camera = case.gaussians.map(lambda t: t.float()), case.camera
    leaves = gaussians.map(lambda tensor: tensor.clone().requires_grad_())

    def gradients(depth: bool, alpha: bool) -> tuple[Tensor, ...]:
        render = rasterize(leaves, camera, depth=depth)
        assert render.depth.numel() == (camera.width * camera.height if depth else 0)
        loss = (render.rgb**2).sum() + (render.alpha.sum() if alpha else 0.0)
        return (render.rgb, *torch.autograd.grad(loss, [tensor for _, tensor in leaves.items()]))

    for alpha in (False, True):
        for whole, without in zip(gradients(True, alpha), gradients(False, alpha), strict=True):
            assert torch.equal(whole, without)
