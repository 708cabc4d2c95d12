"""The literature's regularizers, capacities and pseudo views against numbers worked by hand, or an
independent few lines in float64."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.methods.elsewhere import (
    correlation,
    difference,
    known_depth,
    seen_through,
    unseen_camera,
)
from framework.methods.neighbours import nearest_distance, nearest_others
from framework.plugin import StepContext, StepStats
from framework.rasterize import rasterize
from framework.types import Camera, Gaussians, Render, View
from plugins.augment.mvs_warp import MvsWarp
from plugins.capacity.co_prune import CoPrune
from plugins.capacity.edge_split import EdgeSplit, edge_scores, sobel
from plugins.capacity.proximity_unpool import ProximityUnpool, between
from plugins.capacity.self_ensemble import SelfEnsemble, Watched, in_uncertain_pixels
from plugins.regularize.anchor_dropout import AnchorDropout
from plugins.regularize.binocular import Binocular, moved
from plugins.regularize.binocular import roughness as disparity_roughness
from plugins.regularize.co_register import CoRegister
from plugins.regularize.cycle_warp import CycleWarp
from plugins.regularize.depth_density import DepthDensity, ranks, scores
from plugins.regularize.depth_local_global import DepthLocalGlobal, compared
from plugins.regularize.depth_pearson import DepthPearson
from plugins.regularize.depth_rank import DepthRank
from plugins.regularize.far_fidelity import FarFidelity
from plugins.regularize.frequency import Frequency
from plugins.regularize.occlusion import Occlusion
from plugins.regularize.opacity_noise import OpacityNoise
from plugins.regularize.patch_smoothness import PatchSmoothness, roughness
from plugins.regularize.removal import Removal
from plugins.regularize.render_consistency import RenderConsistency
from plugins.regularize.sharpness import Sharpness
from tests.plugins.fakes import Log, context, stage, wall_of_gaussians
from tests.warp.stage import photograph


def at_work(**changes: Any) -> StepContext:
    """A context whose Gaussians are parameters and can be rendered from anywhere."""
    ctx = context(**{k: v for k, v in changes.items() if k in ("gaussians", "step", "seed", "log")})
    gaussians = ctx.gaussians.map(lambda t: t.clone().requires_grad_())

    def render(camera: Camera, others: Gaussians | None = None, **options: Any) -> Render:
        chosen = ctx.gaussians if others is None else others
        return rasterize(chosen, camera, **{"background": torch.zeros(3), **options})

    own = {k: v for k, v in changes.items() if k in ("other", "second", "depth", "views")}
    return replace(ctx, gaussians=gaussians, render=render, behind=torch.zeros(3), **own)


def shown(depth: Tensor, alpha: float = 1.0, n: int = 1) -> Render:
    """A render of this expected depth."""
    full = torch.full(depth.shape, alpha)
    return Render(torch.zeros(3, *depth.shape), full, depth * alpha, torch.ones(n))


def true_depth() -> tuple[StepContext, View, Tensor]:
    """A context, its first view and the known depth there."""
    ctx = context()
    return ctx, ctx.views[0], ctx.depth[0].depth


# Shared parts


def test_known_depth_is_that_of_the_view_at_its_size() -> None:
    ctx, view, depth = true_depth()
    found, valid = known_depth(ctx, view) or (depth, depth)
    assert torch.equal(found, depth) and valid.all()
    small = replace(view, camera=view.camera.scaled(2), image=view.image[:, ::2, ::2])
    halved, valid = known_depth(ctx, small) or (depth, depth)
    assert halved.shape == small.image.shape[1:] and valid.all()
    assert torch.allclose(halved[0, 0], depth[:2, :2].mean())
    assert known_depth(ctx, replace(view, name="pseudo-1")) is None
    gone = replace(ctx.depth[0], confidence=torch.zeros_like(depth))
    assert not (known_depth(replace(ctx, depth=(gone, *ctx.depth[1:])), view) or (0, depth))[
        1
    ].any()


def test_an_unseen_camera_is_between_two_neighbours() -> None:
    ctx = context()
    cameras = [view.camera for view in ctx.views]
    for seed in range(8):
        camera = unseen_camera(ctx, stream(seed, "test"), cameras[0].scaled(2))
        a, b = min(
            ((a, b) for a in cameras for b in cameras if a is not b),
            key=lambda p: (
                float((p[0].center - camera.center).norm() + (p[1].center - camera.center).norm())
                - float((p[0].center - p[1].center).norm())
            ),
        )
        through = (a.center - camera.center).norm() + (camera.center - b.center).norm()
        assert float(through) == pytest.approx(float((a.center - b.center).norm()))
        assert (camera.width, camera.height) == (40, 30)
        R = camera.viewmat[:3, :3]
        assert torch.allclose(R @ R.T, torch.eye(3, dtype=torch.float64), atol=1e-9)
    alone = replace(ctx, views=ctx.views[:1])
    camera = unseen_camera(alone, stream(1, "test"), cameras[0])
    assert 0 < float((camera.center - cameras[0].center).norm()) < 0.2 * ctx.extent


def test_seen_through_exact_depth_is_what_is_seen() -> None:
    views, depth = stage()
    found, valid, there = seen_through(
        views[1].image, depth[0].depth, views[0].camera, views[1].camera
    )
    error = (found - views[0].image).abs().mean(0)[valid]
    assert valid.float().mean() > 0.75 and float(error.median()) < 0.02
    assert (there[valid] > 0).all()
    # through itself nothing changes, to the last pixel
    same, valid, there = seen_through(
        views[0].image, depth[0].depth, views[0].camera, views[0].camera
    )
    assert torch.allclose(same, views[0].image, atol=1e-3) and valid[1:-1, 1:-1].all()
    assert torch.allclose(there, depth[0].depth, atol=1e-4)


def test_correlation_and_neighbours() -> None:
    a, b = torch.tensor([1.0, 2, 3, 5]), torch.tensor([2.0, 4, 7, 9])
    assert float(correlation(a, b)) == pytest.approx(np.corrcoef(a, b)[0, 1], abs=1e-6)
    assert float(correlation(a, -3 * a + 2)) == pytest.approx(-1)
    assert float(correlation(a, torch.ones(4))) == 0
    points = torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [3, 0, 0]])
    distances, rows = nearest_others(points, 2)
    assert distances.tolist() == [[1, 3], [1, 2], [0, 2], [0, 2]]
    assert rows[0].tolist()[0] == 1 and rows[2, 0] == 3 and rows[3, 0] == 2
    assert nearest_others(points[:1], 2)[1].shape == (1, 0)
    assert nearest_distance(points, points[1:2]).tolist() == [1, 0, 2, 2]
    assert math.isinf(nearest_distance(points, points[:0])[0])


def test_the_difference_of_two_renders_has_a_gradient_in_both() -> None:
    first, second = (torch.rand(3, 12, 14).requires_grad_() for _ in range(2))
    loss = difference(first, second, 0.0)
    assert float(loss) == pytest.approx(float((first - second).abs().mean()), rel=1e-5)
    one, other = torch.autograd.grad(loss, [first, second])
    assert torch.allclose(one, -other) and torch.allclose(
        one, (first - second).detach().sign() / first.numel()
    )
    alone = difference(first, second.detach(), 0.2)
    assert not torch.equal(alone, loss) and alone.requires_grad


# Dropout


def test_opacity_noise_keeps_opacities_below_one() -> None:
    gaussians = wall_of_gaussians(4000).replace(opacity_logits=torch.linspace(-4, 6, 4000))
    factors, _ = OpacityNoise(sigma=0.5).opacity_factors(context(gaussians=gaussians), None)
    rendered = factors * gaussians.opacities
    assert float(rendered.max()) <= 1 + 1e-6 and 0.5 <= float(factors.min()) < 0.51
    low = factors[:400] - 1  # no opacity near one: N(0, 1/4), cut off at 1/2
    assert abs(float(low.mean())) < 0.05 and float((low.abs() >= 0.4999).float().mean()) > 0.2


def test_removal_drops_a_share_and_thins_the_rest_in_the_end() -> None:
    ctx = context(gaussians=wall_of_gaussians(4000))
    removal = Removal(p=0.3)
    factors, _ = removal.opacity_factors(ctx, None)
    assert set(factors.tolist()) == {0.0, 1.0} and float(factors.mean()) == pytest.approx(
        0.7, abs=0.03
    )
    thin = removal.evaluated(ctx.gaussians, None)
    assert torch.allclose(thin.opacities, 0.7 * ctx.gaussians.opacities, atol=1e-6)


def test_anchors_take_their_neighbours_along() -> None:
    """Two far groups of three: who goes, goes with its group."""
    n = 300
    group = torch.arange(n) // 3
    means = torch.stack([10.0 * group, torch.arange(n) % 3 * 0.1, torch.zeros(n)], 1)
    gaussians = wall_of_gaussians(n).replace(means=means)
    plugin = AnchorDropout(p=0.2, neighbours=2)
    kept, state = plugin.opacity_factors(context(gaussians=gaussians), None)
    assert kept is not None
    groups = kept.view(-1, 3)
    assert (groups.min(1).values == groups.max(1).values).all() and 0 < float(kept.mean()) < 1
    plugin.check_state(state, gaussians, 0, ())
    with pytest.raises(ValueError, match="rows of 300"):
        plugin.check_state((state[0] + n, *state[1:]), gaussians, 0, ())
    early = plugin.opacity_factors(context(gaussians=gaussians, step=0), None)[0]
    assert early is None  # none at the beginning


def test_near_and_crowded_ones_are_dropped_more_often() -> None:
    assert ranks(torch.tensor([3.0, 1, 2, 9])).tolist() == [0.5, 0, 0.25, 0.75]
    ctx = context(gaussians=wall_of_gaussians(3000))
    found = scores(ctx)
    assert float(found.min()) >= 0 and float(found.max()) <= 1
    centers = torch.stack([view.camera.center.float() for view in ctx.views])
    distance = torch.cdist(ctx.gaussians.means, centers).min(1).values
    order = distance.argsort()
    assert float(found[order[:1000]].mean()) > 1.5 * float(found[order[2000:]].mean())
    factors, state = DepthDensity(first=0.2, last=0.2).opacity_factors(ctx, None)
    assert factors is not None
    assert float(1 - factors.mean()) == pytest.approx(0.2, abs=0.03)
    again = DepthDensity().opacity_factors(ctx, state)[1]
    assert again is state  # not measured anew for the same set


# Depth


def test_pearson_knows_neither_scale_nor_offset() -> None:
    ctx, view, depth = true_depth()
    plugin = DepthPearson()
    assert float(plugin.loss(ctx, None, view, shown(3 * depth + 1))) == pytest.approx(0, abs=1e-5)  # type: ignore[arg-type]
    other = torch.rand(depth.shape) + 1
    expected = 1 - np.corrcoef(other.double().reshape(-1), depth.double().reshape(-1))[0, 1]
    assert float(plugin.loss(ctx, None, view, shown(other, 0.5))) == pytest.approx(
        expected, abs=1e-5
    )  # type: ignore[arg-type]
    assert plugin.loss(ctx, None, replace(view, name="pseudo"), shown(depth)) is None
    assert plugin.loss(ctx, None, view, shown(depth, 0.0)) is None
    inverse = DepthPearson(inverse=True).loss(ctx, None, view, shown(other))
    expected = 1 - np.corrcoef(1 / other.reshape(-1), 1 / depth.reshape(-1))[0, 1]
    assert inverse is not None and float(inverse) == pytest.approx(expected, abs=1e-5)


def test_the_farthest_pixels_count_once_more() -> None:
    ctx, view, depth = true_depth()
    rendered = torch.rand(view.image.shape, generator=torch.Generator().manual_seed(2))
    mask = torch.ones(depth.shape)
    mask[:, 60:] = 0.0
    found = FarFidelity(share=0.1).loss(
        ctx, None, replace(view, mask=mask), replace(shown(depth), rgb=rendered)
    )
    far = np.sort(depth[:, :60].numpy().reshape(-1))[-int(0.1 * 60 * 60) :].min()
    chosen = (depth.numpy() >= far) & (np.arange(80) < 60)
    error = np.abs(rendered.double().numpy() - view.image.double().numpy())[:, chosen]
    assert found is not None and float(found) == pytest.approx(error.mean(), rel=1e-5)
    assert 0.1 <= chosen[:, :60].mean() < 0.2
    pseudo = replace(view, name="pseudo")
    assert FarFidelity().loss(ctx, None, pseudo, shown(depth)) is None


def test_rank_asks_for_the_order_alone() -> None:
    ctx, view, depth = true_depth()
    plugin = DepthRank(margin=0.0, continuity=0.0)
    assert float(plugin.loss(ctx, None, view, shown(depth**2))) == 0  # type: ignore[arg-type]
    wrong = plugin.loss(ctx, None, view, shown(20 - depth))
    assert wrong is not None
    # by hand, with the same pairs
    drawn = ctx.rng("pairs").integers(depth.numel(), size=(2, plugin.pairs))
    a, b = (depth.reshape(-1).double()[torch.from_numpy(d)] for d in drawn)
    expected = ((a - b).abs() / ctx.near).sum() / (a != b).sum()
    assert float(wrong) == pytest.approx(float(expected), rel=1e-4)
    assert plugin.loss(ctx, None, replace(view, name="pseudo"), shown(depth)) is None


def test_continuity_counts_steps_where_none_should_be() -> None:
    plugin = DepthRank(margin=0.1)
    depth, valid = torch.full((2, 3), 5.0), torch.ones(2, 3, dtype=torch.bool)
    depth[:, 2] = 9.0  # an edge that is known: its step is free
    rendered = torch.tensor([[1.0, 1.5, 7.0], [1.0, 1.0, 7.0]])
    # steps: down 0, .5, 0; right .5 (row 0), 0 (row 1); the edges do not count
    expected = (0.4 + 0.4) / 5
    assert float(plugin._continuity(rendered, depth, valid)) == pytest.approx(expected)


def test_patches_are_compared_by_their_form() -> None:
    rng = np.random.default_rng(0)
    rendered, known = rng.random((9, 11)) + 1, rng.random((9, 11)) + 1
    valid = np.ones((9, 11), bool)
    valid[0, 0] = False  # the first patch is left out

    def by_hand(patch: int, margin: float) -> float:
        tiles = [
            (r, c)
            for r in range(0, 9 // patch * patch, patch)
            for c in range(0, 11 // patch * patch, patch)
            if valid[r : r + patch, c : c + patch].all()
        ]
        pair = [
            np.stack([x[r : r + patch, c : c + patch].reshape(-1) for r, c in tiles])
            for x in (rendered, known)
        ]
        total = 0.0
        for weight, local in ((0.1, True), (1.0, False)):
            normal = []
            for x in pair:
                image = x.std(ddof=1)
                by = x.std(1, ddof=1, keepdims=True) if local else image
                normal.append((x - x.mean(1, keepdims=True)) / (by + 0.01 * image))
            residual = np.abs(normal[0] - normal[1])
            kept = residual > margin
            total += weight * (residual[kept] ** 2).mean()
        return total

    tensors = [torch.from_numpy(x).float().requires_grad_() for x in (rendered, known)]
    found = compared(tensors[0], tensors[1].detach(), torch.from_numpy(valid), 4, 0.05)
    assert found is not None and float(found) == pytest.approx(by_hand(4, 0.05), rel=1e-4)
    assert compared(tensors[0], tensors[1], torch.from_numpy(valid), 20, 0.0) is None


def test_hard_depth_moves_places_and_soft_depth_opacities() -> None:
    ctx = at_work(step=50)
    view = ctx.views[0]
    steps = list(DepthLocalGlobal().substeps(ctx, None, view))
    assert [names for _, names in steps] == [("means",), ("opacity_logits",)]
    for loss, (name,) in steps:
        found = torch.autograd.grad(
            loss, [t for _, t in ctx.gaussians.items()], allow_unused=True, retain_graph=True
        )
        moved_by = {
            n for (n, _), g in zip(ctx.gaussians.items(), found, strict=True) if g is not None
        }
        assert moved_by == {name}
    early = list(DepthLocalGlobal().substeps(replace(ctx, step=0), None, view))
    assert [names for _, names in early] == [("means",)]


def test_smoothness_of_a_patch() -> None:
    """A ramp of 1 per column: one of two squared steps per pixel is 1."""
    ramp = torch.arange(16.0).repeat(16, 1)
    assert float(roughness(ramp, torch.ones(16, 16), 8)) == pytest.approx(1)
    assert float(roughness(ramp, torch.full((16, 16), 0.5), 8)) == pytest.approx(0.5)
    assert float(roughness(ramp[:4, :4], torch.ones(4, 4), 8)) == 0
    step = torch.zeros(8, 16)
    step[:, 8:] = 5.0  # a step between patches is free
    assert float(roughness(step, torch.ones(8, 16), 8)) == 0
    ctx = at_work(step=0)
    falling = PatchSmoothness(initial=100.0, falling=0.5)
    first = falling.loss(ctx, None, ctx.views[0], shown(ctx.depth[0].depth))
    camera = unseen_camera(ctx, ctx.rng("camera"), ctx.views[0].camera)
    seen = ctx.render(camera, ctx.gaussians)
    assert first is not None
    by_hand = 100 * roughness(seen.expected_depth / ctx.extent, seen.alpha, 8)
    assert float(first) == pytest.approx(float(by_hand), rel=1e-5)


def test_what_is_near_to_a_camera_should_be_transparent() -> None:
    gaussians = wall_of_gaussians(4).replace(
        means=torch.tensor([[-0.5, 0, 1.0], [-0.5, 0, 1.2], [-0.5, 0, 6], [-0.5, 0, -1]]),
        opacity_logits=torch.tensor([0.0, math.log(3), 5, 5]),
    )
    ctx = replace(context(gaussians=gaussians), near=2.0)
    view = ctx.views[0]
    z = gaussians.means.double() @ view.camera.viewmat[2, :3] + view.camera.viewmat[2, 3]
    near = z < 1.4
    render = Render(torch.zeros(3, 1, 1), torch.ones(1, 1), torch.ones(1, 1), (z > 0).float())
    found = Occlusion().loss(ctx, None, view, render)
    expected = gaussians.opacities[near & (z > 0)].mean()
    assert found is not None and float(found) == pytest.approx(float(expected))
    far = replace(render, radii=torch.tensor([0.0, 0, 1, 0]))
    assert Occlusion().loss(ctx, None, view, far) is None


def test_what_is_finer_than_open_frequencies_pays() -> None:
    """By hand in float64: discs at depth z, limits of 2^octaves / pi pixels that halve."""
    plugin = Frequency(octaves=2.0, opened=0.5)
    assert plugin.limit(0.0) == pytest.approx(4 / math.pi)
    assert plugin.limit(0.25) == pytest.approx(2 / math.pi)
    assert plugin.limit(0.5) == plugin.limit(0.9) == pytest.approx(1 / math.pi)
    scales = torch.tensor([[0.001, 0.01, 0.5], [0.2, 0.3, 0.4], [0.02, 0.02, 0.02]])
    gaussians = wall_of_gaussians(3).replace(log_scales=scales.log())
    ctx = context(gaussians=gaussians, step=25)
    view = ctx.views[0]
    render = replace(shown(ctx.depth[0].depth), radii=torch.tensor([3.0, 1.0, 0.0]))
    pose, K = view.camera.viewmat, view.camera.K
    total = 0.0
    for mean, scale in ((gaussians.means[0], 0.01), (gaussians.means[1], 0.3)):
        z = float(mean.double() @ pose[2, :3] + pose[2, 3])
        limit = 2 / math.pi * z / float(K[0, 0])
        total += max(0.0, math.log(limit / scale)) ** 2
    found = plugin.loss(ctx, None, view, render)
    assert found is not None and total > 0 and float(found) == pytest.approx(total / 2, rel=1e-4)
    half = replace(view, camera=view.camera.scaled(2), image=view.image[:, ::2, ::2])
    assert torch.allclose(plugin.loss(ctx, None, half, render), found)  # type: ignore[arg-type]
    assert plugin.loss(replace(ctx, step=50), None, view, render) is None


def test_a_warped_photo_is_of_one_view_drawn_evenly() -> None:
    """And what it shows is the stage as its own camera would photograph it."""
    plugin = MvsWarp(sigma_center=0.1, sigma_rotation=0.5, min_coverage=0.1)
    drawn = []
    for seed in range(60):
        chosen, _ = plugin.select(context(seed=seed), None, stage()[0][0].camera)
        drawn += chosen
    assert sorted(set(drawn)) == [0, 1, 2] and min(map(drawn.count, range(3))) >= 10
    ctx = context(epoch=0)
    (view,), _ = plugin.pseudo_views(ctx, plugin.init_state(ctx))
    photo = photograph(view.camera, samples=2)
    assert view.mask is not None
    valid = view.mask > 0.5
    error = (view.image - photo.image).abs().mean(0)[valid]
    assert 0.3 < float(valid.float().mean()) < 1 and float(error.median()) < 0.03
    assert float(view.image[:, ~valid].abs().max()) == 0


# Renders from elsewhere


def test_a_camera_beside_sees_points_where_the_disparity_says() -> None:
    camera = stage()[0][0].camera
    beside = moved(camera, 0.25)
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


# Capacities


def stats(ctx: StepContext, view: View | None = None) -> StepStats:
    n = len(ctx.gaussians)
    return StepStats(torch.zeros(n, 2), torch.ones(n), 80, 60, view=view)


def test_co_pruning_removes_what_the_other_field_has_not() -> None:
    ctx = replace(context(step=4), extent=2.0, other=wall_of_gaussians().rows(0, 200))
    plugin = CoPrune(distance=0.05, every=0.05)
    edits, _ = plugin.update(ctx, None, stats(ctx))
    assert edits is not None and edits.keep is not None
    apart = torch.cdist(ctx.gaussians.means.double(), ctx.other.means.double()).min(1).values
    assert torch.equal(edits.keep, apart <= 0.1) and edits.keep[:200].all() and not edits.keep.all()
    assert plugin.update(replace(ctx, step=5), None, stats(ctx))[0] is None  # not due
    assert plugin.update(replace(ctx, other=None), None, stats(ctx))[0] is None


def test_unpooling_puts_new_ones_between_far_neighbours() -> None:
    means = torch.tensor([[0.0, 0, 0], [2, 0, 0], [0, 4, 0], [0, 0, 6]])
    gaussians = wall_of_gaussians(4).replace(
        means=means, opacity_logits=torch.arange(4.0), log_scales=torch.arange(12.0).view(4, 3)
    )
    ctx = replace(context(gaussians=gaussians, step=9), extent=1.0)
    plugin = ProximityUnpool(far=4.5, every=0.1, at_most=10)
    edits, _ = plugin.update(ctx, None, stats(ctx))
    # mean squared distances to the three others: 56/3, 22.7, 29.3, 42.7; roots 4.3, 4.8, 5.4, 6.5
    assert edits is not None and edits.append is not None and len(edits.append) == 9
    new = between(gaussians, torch.tensor([0]), torch.tensor([[1, 2, 3]]))
    assert torch.equal(new.means, means[1:] / 2) and torch.equal(new.sh0, torch.zeros(3, 1, 3))
    assert new.opacity_logits.tolist() == [1, 2, 3]
    assert torch.equal(new.log_scales, gaussians.log_scales[1:])
    assert new.quats.tolist() == [[1, 0, 0, 0]] * 3
    few = ProximityUnpool(far=4.5, every=0.1, at_most=0.75).update(ctx, None, stats(ctx))[0]
    assert few is not None and few.append is not None and len(few.append) == 3  # the farthest
    assert torch.allclose(few.append.means[0], (means[3] + means[0]) / 2)


def test_edge_scores_are_means_under_the_blend_weights() -> None:
    image = torch.zeros(3, 6, 8)
    image[:, :, 4:] = 1.0
    edges = sobel(image)
    assert edges[:, 3:5].eq(1).all() and edges[:, :3].eq(0).all() and edges[:, 5:].eq(0).all()
    ctx = at_work(gaussians=wall_of_gaussians(40))
    view = ctx.views[0]
    score = edge_scores(replace(ctx, gaussians=ctx.gaussians.detach()), view)
    # by taking a Gaussian's colour away: the weight of each pixel is what its image loses
    g = 7
    bright = ctx.gaussians.detach().replace(sh0=torch.zeros(40, 1, 3))
    dark = bright.sh0.clone()
    dark[g] -= 1.0
    loss = (
        ctx.render(view.camera, bright).rgb - ctx.render(view.camera, bright.replace(sh0=dark)).rgb
    )[0]
    expected = float((loss * sobel(view.image)).sum() / loss.sum().clamp(min=1e-12))
    assert float(score[g]) == pytest.approx(expected, rel=1e-3)
    seen = replace(ctx, gaussians=ctx.gaussians.detach(), step=4)
    plugin = EdgeSplit(score=0.0, large=0.0, every=0.05, at_most=0.05)
    edits, _ = plugin.update(seen, None, stats(seen, view))
    assert edits is not None and edits.keep is not None and edits.append is not None
    assert int((~edits.keep).sum()) == 2 and len(edits.append) == 4
    assert set((~edits.keep).nonzero()[:, 0].tolist()) == set(
        score.argsort(descending=True)[:2].tolist()
    )


def test_the_second_field_is_shaken_where_its_renders_differ() -> None:
    ctx = replace(at_work(step=4), gaussians=wall_of_gaussians(), second=True)
    plugin = SelfEnsemble(every=0.05, cameras=1, first=0.1, last=0.1)
    state = plugin.init_state(ctx)
    assert plugin.update(replace(ctx, second=False), state, stats(ctx)) == (None, state)
    for step in (4, 9):
        edits, state = plugin.update(replace(ctx, step=step), state, stats(ctx))
        assert edits is None
    looks = state.looks[0].clone()
    assert looks.shape[0] == 2
    looks[:, :, :, :8] += torch.tensor([0.5, -0.5]).view(2, 1, 1, 1)  # uncertain on the left
    edits, state = plugin.update(
        replace(ctx, step=14), Watched(state.cameras, (looks,)), stats(ctx)
    )
    assert edits is not None and set(edits.values) == {"means", "log_scales", "opacity_logits"}
    shaken = (edits.values["means"] != ctx.gaussians.means).any(1)
    assert torch.equal(shaken, in_uncertain_pixels(ctx.gaussians.means, state, 0.05))
    assert 0 < int(shaken.sum()) < len(shaken)
    plugin.check_state(state, ctx.gaussians, 0, ())


def test_what_is_logged_begins_with_the_plugin() -> None:
    log = Log({})
    ctx = replace(context(step=4, log=log), other=wall_of_gaussians(seed=5))
    CoPrune(distance=1e5).update(ctx, None, stats(ctx))
    assert list(log.values) == ["co_prune_removed"]
