"""The literature's terms of depth, patches and frequencies, and its warped photos, against numbers
worked by hand, or an independent few lines in float64."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.toolbox.elsewhere import known_depth, unseen_camera
from framework.types import PSEUDO, Render
from plugins.augment.mvs_warp import MvsWarp
from plugins.regularize.depth_local_global import DepthLocalGlobal, compared
from plugins.regularize.depth_pearson import DepthPearson
from plugins.regularize.depth_rank import DepthRank
from plugins.regularize.far_fidelity import FarFidelity
from plugins.regularize.frequency import Frequency
from plugins.regularize.occlusion import Occlusion
from plugins.regularize.patch_smoothness import PatchSmoothness, roughness
from tests.plugins.at_work import at_work, shown, true_depth
from tests.plugins.fakes import context, stage, wall_of_gaussians
from tests.warp.stage import photograph


def test_pearson_knows_neither_scale_nor_offset() -> None:
    ctx, view, depth = true_depth()
    plugin = DepthPearson()
    assert float(plugin.loss(ctx, None, view, shown(3 * depth + 1))) == pytest.approx(0, abs=1e-5)  # type: ignore[arg-type]
    other = torch.rand(depth.shape) + 1
    expected = 1 - np.corrcoef(other.double().reshape(-1), depth.double().reshape(-1))[0, 1]
    assert float(plugin.loss(ctx, None, view, shown(other, 0.5))) == pytest.approx(
        expected, abs=1e-5
    )  # type: ignore[arg-type]
    assert plugin.loss(ctx, None, replace(view, tags=(PSEUDO,)), shown(depth)) is None
    assert plugin.loss(ctx, None, view, shown(depth, 0.0)) is None
    inverse = DepthPearson(inverse=True).loss(ctx, None, view, shown(other))
    expected = 1 - np.corrcoef(1 / other.reshape(-1), 1 / depth.reshape(-1))[0, 1]
    assert inverse is not None and float(inverse) == pytest.approx(expected, abs=1e-5)


def test_the_farthest_pixels_count_once_more() -> None:
    ctx, view, depth = true_depth()
    rendered = torch.rand(view.image.shape, generator=torch.Generator().manual_seed(2))
    mask = torch.ones(depth.shape)
    mask[:, 60:] = 0.0
    actual = FarFidelity(share=0.1).loss(
        ctx, None, replace(view, mask=mask), replace(shown(depth), rgb=rendered)
    )
    far = np.sort(depth[:, :60].numpy().reshape(-1))[-int(0.1 * 60 * 60) :].min()
    chosen = (depth.numpy() >= far) & (np.arange(80) < 60)
    error = np.abs(rendered.double().numpy() - view.image.double().numpy())[:, chosen]
    assert actual is not None and float(actual) == pytest.approx(error.mean(), rel=1e-5)
    assert 0.1 <= chosen[:, :60].mean() < 0.2
    pseudo = replace(view, tags=(PSEUDO,))
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
    assert plugin.loss(ctx, None, replace(view, tags=(PSEUDO,)), shown(depth)) is None


def test_patches_are_compared_by_their_form() -> None:
    rng = np.random.default_rng(0)
    rendered, reference = rng.random((9, 11)) + 1, rng.random((9, 11)) + 1
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
            for x in (rendered, reference)
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

    tensors = [torch.from_numpy(x).float().requires_grad_() for x in (rendered, reference)]
    actual = compared(tensors[0], tensors[1].detach(), torch.from_numpy(valid), 4, 0.05, 1.0)
    assert actual is not None and float(actual) == pytest.approx(by_hand(4, 0.05), rel=1e-4)
    assert compared(tensors[0], tensors[1], torch.from_numpy(valid), 20, 0.0, 1.0) is None


def test_hard_depth_moves_places_and_soft_depth_opacities() -> None:
    ctx = at_work(step=50)
    view = ctx.views[0]
    steps = list(DepthLocalGlobal().substeps(ctx, None, view))
    assert [names for _, names in steps] == [("means",), ("opacity_logits",)]
    for loss, (name,) in steps:
        actual = torch.autograd.grad(
            loss, [t for _, t in ctx.gaussians.items()], allow_unused=True, retain_graph=True
        )
        moved_by = {
            n for (n, _), g in zip(ctx.gaussians.items(), actual, strict=True) if g is not None
        }
        assert moved_by == {name}
    patch = int(ctx.rng("patches").integers(5, 18))
    logits = torch.full_like(ctx.gaussians.opacity_logits, math.log(0.95 / 0.05))
    opaque = ctx.gaussians.detach().replace(opacity_logits=logits)
    seen, actual = ctx.render(view.camera, opaque), known_depth(ctx, view)
    assert actual is not None
    valid = actual[1] & (seen.alpha > 1e-6)
    rendered = seen.expected_depth.detach().requires_grad_()
    hard = compared(rendered, actual[0], valid, patch, 2.5e-4, 1.0)
    assert hard is not None and float(hard) == pytest.approx(float(steps[0][0]), rel=1e-5)
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
    seen = torch.ones(8, 8)
    seen[:, 4:] = 0  # a pixel that shows nothing has no depth, not that of the camera
    assert float(roughness(5.0 * seen, seen, 8)) == 0
    assert float(roughness(5.0 * seen.T, seen.T, 8)) == 0
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
    actual = Occlusion().loss(ctx, None, view, render)
    expected = gaussians.opacities[near & (z > 0)].mean()
    assert actual is not None and float(actual) == pytest.approx(float(expected))
    far = replace(render, radii=torch.tensor([0.0, 0, 1, 0]))
    assert Occlusion().loss(ctx, None, view, far) is None


def test_what_is_finer_than_open_frequencies_pays() -> None:
    """Computed by hand in float64: discs at depth z, limits of 2^octaves / pi pixels that halve."""
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
    actual = plugin.loss(ctx, None, view, render)
    assert actual is not None and total > 0 and float(actual) == pytest.approx(total / 2, rel=1e-4)
    half = replace(view, camera=view.camera.scaled(2), image=view.image[:, ::2, ::2])
    assert torch.allclose(plugin.loss(ctx, None, half, render), actual)  # type: ignore[arg-type]
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
