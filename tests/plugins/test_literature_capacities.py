"""The literature's capacities and second fields, against numbers worked by hand, or an
independent few lines in float64."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.plugin import StepContext, StepStats
from framework.types import View
from plugins.capacity.co_prune import CoPrune
from plugins.capacity.edge_split import EdgeSplit, edge_scores, sobel
from plugins.capacity.proximity_unpool import ProximityUnpool, between
from plugins.capacity.self_ensemble import SelfEnsemble, Watched, in_uncertain_pixels
from tests.plugins.at_work import at_work
from tests.plugins.fakes import context, wall_of_gaussians


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
    # standard deviations e^2, e^5, e^8 and e^11; above 2 x 100 are the last two
    wide = ProximityUnpool(far=2.25, large=100.0, every=0.1, at_most=10)
    edits, _ = wide.update(replace(ctx, extent=2.0), None, stats(ctx))
    assert edits is not None and edits.append is not None and len(edits.append) == 6


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


def test_only_large_ones_on_edges_are_split() -> None:
    ctx = at_work(gaussians=wall_of_gaussians(60), step=4)
    seen = replace(ctx, gaussians=ctx.gaussians.detach(), extent=2.0)
    score = edge_scores(seen, ctx.views[0])
    sharp, large = score >= score.median(), seen.gaussians.scales.amax(1) > 2 * 0.048
    assert all(0 < int((sharp & size).sum()) < 30 for size in (large, ~large))
    plugin = EdgeSplit(score=float(score.median()), large=0.048, every=0.05, at_most=1.0)
    edits, _ = plugin.update(seen, None, stats(seen, ctx.views[0]))
    assert edits is not None and edits.keep is not None
    assert torch.equal(~edits.keep, sharp & large)


def test_the_second_field_is_shaken_where_its_renders_differ() -> None:
    model = wall_of_gaussians(seed=5)
    ctx = replace(at_work(step=4), gaussians=wall_of_gaussians(), second=True, other=model)
    plugin = SelfEnsemble(every=0.05, cameras=1, first=0.1, last=0.1)
    state = plugin.init_state(ctx)
    assert plugin.update(replace(ctx, second=False), state, stats(ctx)) == (None, state)
    for step in (4, 9):
        edits, state = plugin.update(replace(ctx, step=step), state, stats(ctx))
        assert edits is None
    looks = state.looks[0].clone()
    assert looks.shape[0] == 2
    assert torch.equal(looks[0], ctx.render(state.cameras[0], model).rgb)  # not of the shaken one
    looks[:, :, :, :8] += torch.tensor([0.5, -0.5]).view(2, 1, 1, 1)  # uncertain on the left
    edits, state = plugin.update(
        replace(ctx, step=14), Watched(state.cameras, (looks,)), stats(ctx)
    )
    assert edits is not None and set(edits.values) == {"means", "log_scales", "opacity_logits"}
    shaken = (edits.values["means"] != ctx.gaussians.means).any(1)
    assert torch.equal(shaken, in_uncertain_pixels(ctx.gaussians.means, state, 0.05, 0.01))
    assert 0 < int(shaken.sum()) < len(shaken)
    moved = (edits.values["means"] - ctx.gaussians.means)[shaken]
    assert float(moved.std()) == pytest.approx(0.1 * ctx.extent, rel=0.3)
    calm = looks.clone()
    calm[:, :, :, :8] = looks.mean(0)[:, :, :8] + torch.tensor([4e-3, -4e-3]).view(2, 1, 1, 1)
    still, _ = plugin.update(replace(ctx, step=14), Watched(state.cameras, (calm,)), stats(ctx))
    assert still is not None and torch.equal(still.values["means"], ctx.gaussians.means)
    plugin.check_state(state, ctx.gaussians, 0, ())


def test_the_noise_falls_exponentially_and_has_the_size_of_what_it_shakes() -> None:
    """Half-way from 0.16 to 0.01 it is their geometric mean, 0.04."""
    gaussians = wall_of_gaussians().replace(opacity_logits=torch.linspace(-2, 3, 400))
    ctx = replace(at_work(), gaussians=gaussians, second=True, other=wall_of_gaussians(seed=5))
    ctx = replace(ctx, step=4, n_steps=8, extent=2.0)
    plugin = SelfEnsemble(cameras=1, uncertain=1.0, least=0.0, first=0.16, last=0.01)
    (camera,) = plugin.init_state(ctx).cameras
    looks = stream(0, "looks").random((2, 3, camera.height, camera.width))
    watched = Watched((camera,), (torch.from_numpy(looks).float(),))
    edits, watched = plugin.update(ctx, watched, stats(ctx))
    chosen = in_uncertain_pixels(gaussians.means, watched, 1.0, 0.0).numpy()
    assert edits is not None and 0 < chosen.sum() < 400
    draws = ctx.rng("noise")
    for name in ("means", "log_scales", "opacity_logits"):
        old = getattr(gaussians, name).double().numpy()
        size = 2.0 if name == "means" else np.abs(old).mean()
        shaken = old + 0.04 * size * draws.standard_normal(old.shape)
        expected = np.where(chosen if old.ndim == 1 else chosen[:, None], shaken, old)
        assert np.allclose(edits.values[name].numpy(), expected, atol=1e-5)
