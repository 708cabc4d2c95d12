"""The literature's dropout and noise, against numbers worked by hand, or an
independent few lines in float64."""

import numpy as np
import pytest
import torch

from plugins.regularize.anchor_dropout import AnchorDropout
from plugins.regularize.depth_density import DepthDensity, ranks, scores
from plugins.regularize.removal import Removal
from tests.plugins.fakes import context, wall_of_gaussians


def test_removal_drops_a_share_and_thins_the_rest_in_the_end() -> None:
    ctx = context(gaussians=wall_of_gaussians(4000))
    removal = Removal(p=0.3)
    factors, _ = removal.opacity_factors(ctx, None)
    assert set(factors.tolist()) == {0.0, 1.0} and float(factors.mean()) == pytest.approx(
        0.7, abs=0.03
    )
    thin = removal.evaluated(ctx, ctx.gaussians, None)
    assert torch.allclose(thin.opacities, 0.7 * ctx.gaussians.opacities, atol=1e-6)


def test_anchors_take_their_neighbours_along() -> None:
    """Two distant groups of three: a dropped Gaussian takes its group with it."""
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


def test_a_score_is_half_nearness_and_half_crowding_and_less_for_far_ones() -> None:
    """In float64, by the places of 60 in both orders; a third of them is 20."""
    ctx = context(gaussians=wall_of_gaussians(60))
    means = ctx.gaussians.means.double().numpy()
    centers = np.stack([view.camera.center.numpy() for view in ctx.views])
    distance = np.linalg.norm(means[:, None] - centers, axis=2).min(1)
    apart = np.sort(np.linalg.norm(means[:, None] - means, axis=2), 1)[:, 1:4].mean(1)
    near, crowded = (values.argsort().argsort() for values in (distance, apart))
    expected = (1 - (near + crowded) / 120) * np.array([1, 0.7, 0.3])[near // 20]
    assert np.allclose(scores(ctx).numpy(), expected, atol=1e-6)


def test_near_and_crowded_ones_are_dropped_more_often() -> None:
    assert ranks(torch.tensor([3.0, 1, 2, 9])).tolist() == [0.5, 0, 0.25, 0.75]
    ctx = context(gaussians=wall_of_gaussians(3000))
    actual = scores(ctx)
    assert float(actual.min()) >= 0 and float(actual.max()) <= 1
    centers = torch.stack([view.camera.center.float() for view in ctx.views])
    distance = torch.cdist(ctx.gaussians.means, centers).min(1).values
    order = distance.argsort()
    assert float(actual[order[:1000]].mean()) > 1.5 * float(actual[order[2000:]].mean())
    factors, state = DepthDensity(first=0.2, last=0.2).opacity_factors(ctx, None)
    assert factors is not None
    assert float((factors == 0).float().mean()) == pytest.approx(0.2, abs=0.03)
    odds = 0.2 * actual / actual.mean()
    assert torch.allclose(factors, (factors > 0) / (1 - odds))  # 1 in expectation
    bare = DepthDensity(first=0.2, last=0.2, compensate=False).opacity_factors(ctx, None)[0]
    assert bare is not None and torch.equal(bare, (factors > 0).float())
    again = DepthDensity().opacity_factors(ctx, state)[1]
    assert again is state  # not measured again for the same set
