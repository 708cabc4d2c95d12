"""The literature's terms on renders from elsewhere, against numbers worked by hand, or an
independent few lines in float64."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from framework.geometry import moved_aside
from framework.toolbox.elsewhere import seen_through, unseen_camera
from framework.types import PSEUDO, Camera, Render, View
from plugins.regularize.binocular import Binocular
from plugins.regularize.binocular import roughness as disparity_roughness
from plugins.regularize.co_register import CoRegister
from plugins.regularize.cycle_warp import CycleWarp
from plugins.regularize.render_consistency import RenderConsistency
from plugins.regularize.sharpness import Sharpness
from tests.numerics.test_photometric_loss import loss_reference
from tests.plugins.at_work import at_work
from tests.plugins.fakes import context, stage, wall_of_gaussians


def dark(masked: int) -> View:
    """A black photo of 8 x 2 pixels and focal length 3.5, without its column `masked`."""
    K = torch.tensor([[3.5, 0, 4], [0, 3.5, 1], [0, 0, 1]])
    mask = torch.ones(2, 8)
    mask[:, masked] = 0
    return View("dark", Camera(torch.eye(4), K, 8, 2), torch.zeros(3, 2, 8), mask)


def brighter_to_the_right(depth: Tensor) -> Render:
    """A render of `depth` [2, 8] whose column c is c / 8."""
    return Render((torch.arange(8.0) / 8).repeat(3, 2, 1), torch.ones(2, 8), depth, torch.ones(1))


def test_a_camera_beside_sees_points_where_the_disparity_says() -> None:
    camera = stage()[0][0].camera
    shifted = moved_aside(camera, 0.25)
    step = shifted.center - camera.center
    assert torch.allclose(step, 0.25 * camera.viewmat[0, :3])
    depth = torch.full((camera.height, camera.width), 4.0)
    columns = torch.arange(camera.width, dtype=torch.float32).repeat(3, camera.height, 1)
    actual, valid, _ = seen_through(columns, depth, camera, shifted)
    disparity = -float(camera.K[0, 0]) * 0.25 / 4.0
    inner = valid & (columns[0] + disparity > 1) & (columns[0] + disparity < camera.width - 2)
    assert inner.float().mean() > 0.5
    assert torch.allclose(actual[0][inner], (columns[0] + disparity)[inner], atol=1e-3)
    image = torch.zeros(3, 2, 3)
    image[:, :, 2] = 1.0
    disparities = torch.tensor([[0.0, 1, 3], [0.0, 1, 3]])
    expected = (1 + 2 * math.exp(-0.33)) / 2
    assert float(disparity_roughness(disparities, image)) == pytest.approx(expected)


@pytest.mark.parametrize(("smooth", "rough"), [(0.0, 0.0), (0.3, 0.5)])
def test_a_photo_should_be_what_is_seen_from_beside_over_all_its_pixels(
    smooth: float, rough: float
) -> None:
    """From one unit to the left a wall at 2 is 3.5 / 2 pixels to the right: column c is (c + 1.75)
    / 8 there, and black in the photo. 6 and 7 are outside, 0 is masked, so the disparity has two
    steps of 1.75 between eight columns."""
    view, ctx = dark(masked=0), context()
    draw = float(ctx.rng("shift").uniform(-1, 1))
    depth = torch.full((2, 8), 2.0).requires_grad_()
    other = brighter_to_the_right(depth.detach())
    other.rgb.requires_grad_()
    places = []

    def render(camera: Camera, *_: Any, **__: Any) -> Render:
        places.append(camera.center)
        return other

    assert draw < 0
    looking = replace(ctx, views=(view,), spacing=2 / -draw, render=render)
    ours = replace(brighter_to_the_right(depth), rgb=torch.zeros(3, 2, 8))
    actual = Binocular(shift=0.5, smooth=smooth).loss(looking, None, view, ours)
    assert actual is not None
    assert torch.allclose(places[0], torch.tensor([-1.0, 0, 0], dtype=torch.float64))
    seen = sum((c + 1.75) / 8 for c in range(1, 6)) / 8
    assert float(actual.detach()) == pytest.approx(seen + smooth * rough)
    in_image, in_depth = torch.autograd.grad(actual, [other.rgb, depth])
    assert float(in_image.sum()) == pytest.approx(5 / 8)
    # a unit of depth is -3.5 / 2^2 pixels
    expected = torch.zeros(2, 8)
    expected[:, 1:6] = -0.875 / 8 / 16
    expected[:, (1, 5)] += smooth * -0.875 / 14
    assert torch.allclose(in_depth, expected, atol=1e-7)


def test_what_returns_counts_by_the_largest_depth(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall at 4 whose last column is at 10, so that 1 is free: what is 1.5 off does not return,
    what is 0.5 off does. Of columns 2 to 7, which are c / 8, column 4 is masked."""
    view, ctx = dark(masked=4), context()
    depth = torch.tensor([4.0, 4, 4, 4, 4, 4, 4, 10]).repeat(2, 1)
    there = torch.tensor([2.5, 2.5, 3.5, 3.5, 4, 4, 4, 10]).repeat(2, 1)
    monkeypatch.setattr("plugins.regularize.cycle_warp.unseen_camera", lambda *_: view.camera)
    shares: dict[str, float] = {}
    looking = replace(
        ctx,
        views=(view,),
        render=lambda *_, **__: brighter_to_the_right(there),
        log=shares.__setitem__,
    )
    actual = CycleWarp(tolerance=0.1).loss(looking, None, view, brighter_to_the_right(depth))
    assert actual is not None
    assert float(actual) == pytest.approx((2 + 3 + 5 + 6 + 7) / 8 / 5, rel=1e-5)
    assert shares == {"cycle_warp_share": 5 / 8}


def test_consistency_compares_with_a_render_that_lacks_some() -> None:
    ctx = at_work()
    view, plugin = ctx.views[0], RenderConsistency(p=0.4, ssim_weight=0.0)
    render = ctx.render(view.camera, ctx.gaussians)
    actual = plugin.loss(ctx, None, view, render)
    kept = torch.from_numpy(ctx.rng("dropped").random(len(ctx.gaussians)) >= 0.4).float()
    other = ctx.render(view.camera, ctx.gaussians, opacity_factors=kept)
    assert actual is not None
    assert float(actual) == pytest.approx(float((render.rgb - other.rgb).abs().mean()), rel=1e-5)
    assert RenderConsistency().loss(ctx, None, replace(view, tags=(PSEUDO,)), render) is None


def test_both_renders_are_pulled_at_and_what_one_keeps_may_be_scaled_up() -> None:
    ctx = at_work()
    view, plugin = ctx.views[0], RenderConsistency(p=0.4, compensate=True, ssim_weight=0.0)
    render = ctx.render(view.camera, ctx.gaussians)
    whole = replace(render, rgb=render.rgb.detach().requires_grad_())
    actual = plugin.loss(ctx, None, view, whole)
    kept = torch.from_numpy(ctx.rng("dropped").random(len(ctx.gaussians)) >= 0.4).float()
    other = ctx.render(view.camera, ctx.gaussians, opacity_factors=kept / 0.6)
    apart = (whole.rgb - other.rgb).abs().mean()
    assert actual is not None and float(actual.detach()) == pytest.approx(float(apart.detach()))
    tensors = [whole.rgb, ctx.gaussians.sh0, ctx.gaussians.means]
    for ours, expected in zip(
        torch.autograd.grad(actual, tensors), torch.autograd.grad(apart, tensors), strict=True
    ):
        assert float(expected.abs().max()) > 0 and torch.allclose(ours, expected, atol=1e-7)


def test_two_fields_are_compared_at_an_unseen_camera() -> None:
    ctx, plugin = at_work(), CoRegister(ssim_weight=0.0)
    view = ctx.views[0]
    render = ctx.render(view.camera, ctx.gaussians)
    assert plugin.loss(ctx, None, view, render) is None  # no second field
    same = replace(ctx, other=ctx.gaussians.detach())
    assert float(plugin.loss(same, None, view, render)) == 0  # type: ignore[arg-type]
    other = wall_of_gaussians(seed=8)
    actual = plugin.loss(replace(ctx, other=other), None, view, render)
    camera = unseen_camera(ctx, ctx.rng("camera"), view.camera)
    expected = (ctx.render(camera, ctx.gaussians).rgb - ctx.render(camera, other).rgb).abs().mean()
    assert actual is not None and float(actual) == pytest.approx(float(expected), rel=1e-5)
    mixed = CoRegister(ssim_weight=0.6).loss(replace(ctx, other=other), None, view, render)
    ours, others = (ctx.render(camera, g).rgb.detach().double() for g in (ctx.gaussians, other))
    assert mixed is not None
    assert float(mixed) == pytest.approx(float(loss_reference(ours, others, None, 0.6)), abs=2e-6)


def test_sharpness_mixes_the_gradient_here_and_uphill() -> None:
    """A quadratic loss |x|^2: uphill by rho times the scale along x its gradient is larger so."""
    gaussians = wall_of_gaussians(5)
    ctx = context(gaussians=gaussians)
    actual = {"means": 2 * gaussians.means, "quats": torch.zeros(5, 4)}
    plugin = Sharpness(rho=0.5, share=0.25)
    mixed = plugin.gradient(ctx, None, actual, lambda g: {"means": 2 * g.means, "quats": g.quats})
    step = 0.5 * gaussians.scales.mean(1, keepdim=True)
    direction = gaussians.means / gaussians.means.norm(dim=1, keepdim=True)
    assert torch.allclose(
        mixed["means"], 2 * gaussians.means + 0.25 * 2 * step * direction, atol=1e-5
    )
    assert torch.allclose(mixed["quats"], 0.25 * gaussians.quats)
