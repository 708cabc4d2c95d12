"""SAFI and the warping augmenter that it is built on."""

from typing import Any

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.plugin import StepContext
from framework.toolbox.warping import WarpingAugmenter, perturbed
from framework.types import View
from plugins.augment.safi import Safi
from tests.plugins.fakes import Log, context, stage, wall_of_gaussians
from tests.warp.stage import camera, photograph


def only_view(augmenter: WarpingAugmenter, now: StepContext, state: Any = None) -> View:
    views, _ = augmenter.pseudo_views(now, state)
    assert len(views) == 1
    return views[0]


def test_one_pseudo_view_that_shows_the_scene() -> None:
    log = Log({})
    view = only_view(Safi(), context(log=log))
    assert view.name == "pseudo-10" and view.tags == () and view.weight == 1.0
    assert view.mask is not None and float(view.mask.mean()) > 0.3
    truth = photograph(view.camera).image
    error = ((view.image - truth) ** 2).mean(0)[view.mask > 0].mean()
    assert float(-10 * torch.log10(error)) > 30
    assert 1 <= log.values["safi_supports"][0] <= 3
    assert log.values["safi_coverage"][0] == pytest.approx(float(view.mask.mean()))


@pytest.mark.parametrize("approximation", ["diagonal", "block"])
def test_unperturbed_camera_is_supported_by_its_own_view_alone(approximation: str) -> None:
    """F(x') = F(x_k) at the picked view: nothing is new to it, much is to the others."""
    log = Log({})
    safi = Safi(sigma_center=0.0, sigma_rotation=0.0, eta=1.0, approximation=approximation)
    view = only_view(safi, context(log=log))
    assert log.values["safi_supports"] == [1]
    source = [v for v in stage()[0] if torch.equal(v.camera.viewmat, view.camera.viewmat)]
    assert len(source) == 1 and view.mask is not None
    inside = view.mask > 0
    torch.testing.assert_close(view.image[:, inside], source[0].image[:, inside], rtol=0, atol=1e-4)


def test_snapshot_is_frozen_unless_refreshed() -> None:
    frozen, fresh = Safi(every=1), Safi(every=1, refresh_epochs=2)
    moved = wall_of_gaussians(seed=8)
    for safi, expected in ((frozen, wall_of_gaussians()), (fresh, moved)):
        _, state = safi.pseudo_views(context(), None)
        _, state = safi.pseudo_views(context(gaussians=moved, step=54, epoch=11), state)
        assert torch.equal(state.selection.gaussians.means, wall_of_gaussians().means)
        _, state = safi.pseudo_views(context(gaussians=moved, step=58, epoch=12), state)
        assert torch.equal(state.selection.gaussians.means, expected.means)


def test_too_little_coverage_gives_no_view_and_says_so() -> None:
    log = Log({})
    views, state = Safi(min_coverage=1.0).pseudo_views(context(log=log), None)
    assert views == [] and state.view is None
    assert 0 < log.values["safi_coverage"][0] < 1


def test_perturbation_has_the_stated_size() -> None:
    start, rng = camera(0.3, yaw=0.2), stream(0, "perturb")
    samples = [perturbed(start, rng, 0.5, 2.0) for _ in range(800)]
    steps = np.stack([(s.center - start.center).numpy() for s in samples])
    assert steps.std(axis=0) == pytest.approx([0.5] * 3, rel=0.1)
    turns = [s.viewmat[:3, :3] @ start.viewmat[:3, :3].T for s in samples]
    cosines = np.array([(float(t.trace()) - 1) / 2 for t in turns])
    angles = np.degrees(np.arccos(np.clip(cosines, -1, 1)))
    assert np.sqrt(np.mean(angles**2)) == pytest.approx(2.0, rel=0.1)
    assert all(torch.allclose(t @ t.T, torch.eye(3).double(), atol=1e-12) for t in turns)
