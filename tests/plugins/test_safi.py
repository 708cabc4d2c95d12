"""SAFI and the warping augmenter that it is built on."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.geometry import mean_neighbour_distance
from framework.plugin import StepContext
from framework.toolbox.warping import WarpingAugmenter, perturbed
from framework.types import Camera, DepthMap, View
from framework.warp.zbuffer import prepare
from plugins.augment.dba import Dba
from plugins.augment.full_set import FullSet
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


@pytest.mark.parametrize("approximation", ["diagonal", "block"])
@pytest.mark.parametrize("form", ["trace", "log"])
def test_selection_does_not_depend_on_the_unit_of_length(form: str, approximation: str) -> None:
    safi = Safi(form=form, approximation=approximation)
    now, target = context(), camera(0.1, 0.05, size=(80, 60))
    chosen, _ = safi.select(now, None, target)
    scaled = [_scaled(c, 1000.0) for c in [*(v.camera for v in now.views), target]]
    gaussians = now.gaussians.replace(
        means=1000 * now.gaussians.means, log_scales=now.gaussians.log_scales + math.log(1000)
    )
    views = tuple(View(v.name, c, v.image) for v, c in zip(now.views, scaled[:-1], strict=True))
    big = StepContext(
        **{
            **vars(now),
            "views": views,
            "gaussians": gaussians,
            "extent": 600.0,
            "spacing": 1000 * now.spacing,
            "near": 2000.0,
        }
    )
    assert safi.select(big, None, scaled[-1])[0] == chosen


def test_snapshot_is_frozen_unless_refreshed() -> None:
    frozen, fresh = Safi(every=1), Safi(every=1, refresh_epochs=2)
    moved = wall_of_gaussians(seed=8)
    for safi, expected in ((frozen, wall_of_gaussians()), (fresh, moved)):
        _, state = safi.pseudo_views(context(), None)
        _, state = safi.pseudo_views(context(gaussians=moved, step=54, epoch=11), state)
        assert torch.equal(state.selection.gaussians.means, wall_of_gaussians().means)
        _, state = safi.pseudo_views(context(gaussians=moved, step=58, epoch=12), state)
        assert torch.equal(state.selection.gaussians.means, expected.means)


def test_what_a_mask_leaves_out_of_a_photo_is_unknown() -> None:
    """The left half of the photos does not count: no view has information on what is only there."""
    now = context()
    mask = torch.ones(now.views[0].image.shape[1:])
    mask[:, : mask.shape[1] // 2] = 0
    masked = replace(now, views=tuple(replace(view, mask=mask) for view in now.views))
    whole, half = (Safi()._snapshot(c).unknown for c in (now, masked))
    for before, after in zip(whole, half, strict=True):
        assert bool((after >= before * (1 - 1e-6)).all())
        assert float(after.sum()) > float(before.sum())
    one = tuple(replace(view, mask=torch.ones_like(mask)) for view in now.views)
    same = Safi()._snapshot(replace(now, views=one)).unknown
    assert all(torch.equal(a, b) for a, b in zip(whole, same, strict=True))


def test_a_view_lives_for_every_epochs() -> None:
    safi, state, names = Safi(every=2), None, []
    for epoch in range(10, 14):
        views, state = safi.pseudo_views(context(step=4 * epoch, epoch=epoch), state)
        names.append(views[0].name)
    assert names == ["pseudo-10", "pseudo-10", "pseudo-12", "pseudo-12"]


def test_too_little_coverage_gives_no_view_and_says_so() -> None:
    log = Log({})
    views, state = Safi(min_coverage=1.0).pseudo_views(context(log=log), None)
    assert views == [] and state.view is None
    assert 0 < log.values["safi_coverage"][0] < 1


def test_coverage_counts_against_what_confident_depth_covers() -> None:
    """A scene whose depth covers the left half of every photo still has pseudo views."""
    now = context()
    half = [replace(d, confidence=d.confidence.clone()) for d in now.depth]
    for depth in half:
        depth.confidence[:, depth.confidence.shape[1] // 2 :] = 0
    whole, halved = Log({}), Log({})
    dba = Dba(min_coverage=0.6)
    only_view(dba, replace(now, log=whole))

    def with_depth(depth: tuple[DepthMap, ...], log: Log) -> StepContext:
        return replace(now, depth=depth, log=log, supports=lambda: prepare(now.views, depth))

    view = only_view(dba, with_depth(tuple(half), halved))
    assert view.mask is not None
    (frame,), (of_depth,) = halved.values["dba_coverage"], halved.values["dba_coverage_of_depth"]
    assert frame == pytest.approx(float(view.mask.mean())) and frame < 0.5
    assert of_depth == pytest.approx(2 * frame)
    assert whole.values["dba_coverage"] == whole.values["dba_coverage_of_depth"]
    nothing = tuple(replace(d, confidence=0 * d.confidence) for d in now.depth)
    refused = Log({})
    views, _ = Dba(min_coverage=0.01).pseudo_views(with_depth(nothing, refused), None)
    assert views == [] and refused.values["dba_refused_coverage"] == [1.0]
    assert refused.values["dba_coverage_of_depth"] == [0.0]


def test_how_far_the_supports_are_is_told_in_camera_spacings() -> None:
    log, now = Log({}), context()
    view = only_view(FullSet(), replace(now, log=log))
    distances = [float((v.camera.center - view.camera.center).norm()) for v in now.views]
    spacing = mean_neighbour_distance([v.camera for v in now.views])
    assert log.values["full_set_support_distance"] == [pytest.approx(sum(distances) / 3 / spacing)]


def test_a_new_method_is_one_select() -> None:
    @dataclass(frozen=True)
    class Everything(WarpingAugmenter):
        def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
            return list(range(len(ctx.views))), selection

    Everything.name = "everything"
    log = Log({})
    only_view(Everything(), context(log=log))
    assert log.values["everything_supports"] == [3]


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


def test_without_roll_the_image_never_turns_in_its_plane() -> None:
    start, rng = camera(0.3, yaw=0.2), stream(0, "perturb")
    tilts = []
    for _ in range(400):
        turned = perturbed(start, rng, 0.0, 2.0, roll=False)
        turn = (turned.viewmat[:3, :3] @ start.viewmat[:3, :3].T).numpy()
        assert turn[1, 0] == pytest.approx(turn[0, 1], abs=1e-12)  # no turn about z
        tilts.append([turn[2, 1], turn[0, 2]])
    assert np.degrees(np.sqrt((np.square(tilts)).sum(1).mean())) == pytest.approx(2.0, rel=0.1)
    assert np.degrees(np.std(tilts, axis=0)) == pytest.approx([2**0.5] * 2, rel=0.15)
    rolled, level = (perturbed(start, stream(0, "p"), 0.5, 2.0, roll) for roll in (True, False))
    torch.testing.assert_close(rolled.center, level.center)  # the same draws otherwise


def _scaled(cam: Camera, unit: float) -> Camera:
    viewmat = cam.viewmat.clone()
    viewmat[:3, 3] *= unit
    return Camera(viewmat, cam.K, cam.width, cam.height)
