"""The literature's terms on renders from elsewhere, against numbers worked by hand, or an
independent few lines in float64."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from framework.geometry import moved_aside
from framework.methods.elsewhere import (
    seen_through,
    unseen_camera,
)
from plugins.regularize.binocular import Binocular
from plugins.regularize.binocular import roughness as disparity_roughness
from plugins.regularize.co_register import CoRegister
from plugins.regularize.cycle_warp import CycleWarp
from plugins.regularize.render_consistency import RenderConsistency
from plugins.regularize.sharpness import Sharpness
from tests.plugins.at_work import at_work
from tests.plugins.fakes import context, stage, wall_of_gaussians


def test_a_camera_beside_sees_points_where_the_disparity_says() -> None:
    camera = stage()[0][0].camera
    beside = moved_aside(camera, 0.25)
    step = beside.center - camera.center
    assert torch.allclose(step, 0.25 * camera.viewmat[0, :3])
    depth = torch.full((camera.height, camera.width), 4.0)
    columns = torch.arange(camera.width, dtype=torch.float32).repeat(3, camera.height, 1)
    found, valid, _ = seen_through(columns, depth, camera, beside)
    disparity = -float(camera.K[0, 0]) * 0.25 / 4.0
    inner = valid & (columns[0] + disparity > 1) & (columns[0] + disparity < camera.width - 2)
    assert inner.float().mean() > 0.5
    assert torch.allclose(found[0][inner], (columns[0] + disparity)[inner], atol=1e-3)
    image = torch.zeros(3, 2, 3)
    image[:, :, 2] = 1.0
    disparities = torch.tensor([[0.0, 1, 3], [0.0, 1, 3]])
    expected = (1 + 2 * math.exp(-0.33)) / 2
    assert float(disparity_roughness(disparities, image)) == pytest.approx(expected)


def test_what_does_not_return_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall at 4 and, for the other camera alone, something before its left half."""
    ctx = at_work()
    view = ctx.views[0]
    own = ctx.render(view.camera, ctx.gaussians)
    flat = replace(own, depth=torch.full_like(own.depth, 4.0), alpha=torch.ones_like(own.alpha))
    hidden = flat.depth.clone()
    hidden[:, : hidden.shape[1] // 2] = 3.5
    other = replace(flat, rgb=1 - view.image, depth=hidden)
    monkeypatch.setattr("plugins.regularize.cycle_warp.unseen_camera", lambda *_: view.camera)
    shares: dict[str, float] = {}
    looking = replace(ctx, render=lambda *_, **__: other, log=shares.__setitem__)
    for tolerance, expected in ((0.01, 0.5), (0.2, 1.0)):
        loss = CycleWarp(tolerance=tolerance).loss(looking, None, view, flat)
        assert loss is not None
        assert shares["cycle_warp_share"] == pytest.approx(expected, abs=0.03)


@pytest.mark.parametrize("plugin", [Binocular(), CycleWarp(tolerance=1.0)])
def test_a_scene_that_is_right_has_a_small_warping_loss(plugin: Any) -> None:
    """Views of the current Gaussians themselves, against the same of others."""
    ctx = at_work()
    view = ctx.views[0]
    render = ctx.render(view.camera, ctx.gaussians)
    own = replace(view, image=render.rgb.detach())
    right = plugin.loss(ctx, None, own, render)
    wrong = plugin.loss(ctx, None, replace(view, image=1 - own.image), render)
    assert right is not None and wrong is not None and right.requires_grad
    assert float(right) < 0.25 * float(wrong)
    assert plugin.loss(ctx, None, replace(view, name="pseudo"), render) is None


def test_consistency_compares_with_a_render_that_lacks_some() -> None:
    ctx = at_work()
    view, plugin = ctx.views[0], RenderConsistency(p=0.4, ssim_weight=0.0)
    render = ctx.render(view.camera, ctx.gaussians)
    found = plugin.loss(ctx, None, view, render)
    kept = torch.from_numpy(ctx.rng("dropped").random(len(ctx.gaussians)) >= 0.4).float()
    other = ctx.render(view.camera, ctx.gaussians, opacity_factors=kept)
    assert found is not None
    assert float(found) == pytest.approx(float((render.rgb - other.rgb).abs().mean()), rel=1e-5)
    assert RenderConsistency().loss(ctx, None, replace(view, name="p"), render) is None


def test_two_fields_are_compared_at_an_unseen_camera() -> None:
    ctx, plugin = at_work(), CoRegister(ssim_weight=0.0)
    view = ctx.views[0]
    render = ctx.render(view.camera, ctx.gaussians)
    assert plugin.loss(ctx, None, view, render) is None  # no second field
    same = replace(ctx, other=ctx.gaussians.detach())
    assert float(plugin.loss(same, None, view, render)) == 0  # type: ignore[arg-type]
    other = wall_of_gaussians(seed=8)
    found = plugin.loss(replace(ctx, other=other), None, view, render)
    camera = unseen_camera(ctx, ctx.rng("camera"), view.camera)
    expected = (ctx.render(camera, ctx.gaussians).rgb - ctx.render(camera, other).rgb).abs().mean()
    assert found is not None and float(found) == pytest.approx(float(expected), rel=1e-5)


def test_sharpness_mixes_the_gradient_here_and_uphill() -> None:
    """A quadratic loss |x|^2: uphill by rho times the scale along x its gradient is larger so."""
    gaussians = wall_of_gaussians(5)
    ctx = context(gaussians=gaussians)
    found = {"means": 2 * gaussians.means, "quats": torch.zeros(5, 4)}
    plugin = Sharpness(rho=0.5, share=0.25)
    mixed = plugin.gradient(ctx, None, found, lambda g: {"means": 2 * g.means, "quats": g.quats})
    step = 0.5 * gaussians.scales.mean(1, keepdim=True)
    direction = gaussians.means / gaussians.means.norm(dim=1, keepdim=True)
    assert torch.allclose(
        mixed["means"], 2 * gaussians.means + 0.25 * 2 * step * direction, atol=1e-5
    )
    assert torch.allclose(mixed["quats"], 0.25 * gaussians.quats)
