"""Guesses where depth is missing: they continue what is around, behind all that others see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.geometry import project
from framework.initialize import Stereo
from framework.initialize.completion import BALL, complete, filled
from framework.initialize.fusion import SurfacePixels, mapped
from framework.types import DepthMap, TrainingSet
from tests.init.synthetic import WALL_Z, camera, points, scene, three_views


def without(depth: DepthMap, rows: slice, columns: slice) -> DepthMap:
    """The map with a region that failed its check."""
    confidence = depth.confidence.clone()
    confidence[rows, columns] = 0
    return DepthMap(depth.depth, confidence)


def flat(depth: DepthMap, z: float) -> DepthMap:
    """A confident plane at depth `z` in place of `depth`."""
    return DepthMap(torch.full_like(depth.depth, z), depth.confidence)


def completed(training: TrainingSet, depth: tuple[DepthMap, ...]) -> SurfacePixels:
    return complete(mapped(training, depth, detail=0.5), tolerance=0.03)


def test_full_depth_needs_no_guess() -> None:
    assert len(completed(*three_views()).xyz) == 0


def test_a_hole_in_a_plane_is_closed_on_the_plane() -> None:
    training, (depth,) = scene([camera(0.0)])
    pixels = completed(training, (without(flat(depth, WALL_Z), slice(20, 30), slice(5, 15)),))
    assert len(pixels.xyz) == 100
    np.testing.assert_allclose(pixels.xyz[:, 2], WALL_Z, rtol=1e-6)
    uv = project(torch.from_numpy(pixels.xyz), training.views[0].camera)[0].numpy()
    np.testing.assert_allclose(uv.min(0), [5.5, 20.5], atol=1e-6)
    rgb = training.views[0].image[:, 20, 5].numpy()
    np.testing.assert_array_equal(pixels.rgb[0], rgb)


def test_what_another_view_shows_is_not_guessed() -> None:
    training, depth = scene([camera(0.0), camera(0.0)])
    wall = flat(depth[0], WALL_Z)
    assert len(completed(training, (without(wall, slice(20), slice(20)), wall)).xyz) == 0


def test_two_views_do_not_guess_the_same_surface_twice() -> None:
    training, (depth, _) = scene([camera(0.0), camera(0.0)])
    holed = without(depth, slice(10), slice(10))
    assert len(completed(training, (holed, holed)).xyz) == 100


def test_a_guess_moves_back_until_nobody_looks_through_it() -> None:
    """The first view knows only near depth around its hole, the second one sees the wall there."""
    training, depth = scene([camera(0.0), camera(0.4)])
    holed = without(flat(depth[0], 3.0), slice(15, 30), slice(20, 40))
    xyz = completed(training, (holed, flat(depth[1], WALL_Z))).xyz
    assert len(xyz) == 15 * 20
    assert xyz[:, 2].min() >= 0.97 * WALL_Z


def test_nothing_is_guessed_among_the_cameras() -> None:
    cameras = [camera(-3.0), camera(3.0)]
    training, depth = scene(cameras)
    holed = tuple(without(flat(d, 0.5), slice(24), slice(64)) for d in depth)
    pixels = completed(training, holed)
    assert len(pixels.xyz) > 0
    middle = torch.stack([c.center for c in cameras]).mean(0).numpy()
    distance = np.linalg.norm(pixels.xyz - middle, axis=1)
    assert distance.min() >= BALL * training.extent


def test_sparse_points_tell_the_depth_where_stereo_fails() -> None:
    training, (depth,) = scene([camera(0.0)])
    xyz = np.stack([np.linspace(-1, 1, 30), np.zeros(30), np.full(30, 20.0)], 1)
    training = replace(training, points=points(xyz, 1))
    unknown = DepthMap(depth.depth, torch.zeros_like(depth.confidence))
    np.testing.assert_allclose(completed(training, (unknown,)).xyz[:, 2], 20.0, rtol=1e-6)
    bare = replace(training, points=points(np.zeros((0, 3)), 1))
    assert len(completed(bare, (unknown,)).xyz) == 0


def test_masked_pixels_stay_out() -> None:
    training, (depth,) = scene([camera(0.0)])
    mask = torch.ones(48, 64)
    mask[:, :10] = 0
    masked = replace(training, views=(replace(training.views[0], mask=mask),))
    assert len(completed(masked, (without(depth, slice(48), slice(20)),)).xyz) == 48 * 10


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (48, 64)])
def test_filling_keeps_the_known_and_stays_between(shape: tuple[int, int]) -> None:
    depth = np.zeros(shape)
    assert (filled(depth) == 0).all()
    depth[0, 0], depth[-1, -1] = 2.0, 8.0
    result = filled(depth)
    assert result[-1, -1] == 8.0
    assert (result >= 2.0 - 1e-9).all() and (result <= 8.0 + 1e-9).all()


def test_the_farther_side_is_preferred() -> None:
    depth = np.zeros((32, 32))
    depth[:, :8], depth[:, 24:] = 2.0, 8.0
    assert np.median(filled(depth)[:, 8:24]) > 1 / (0.5 * (1 / 2 + 1 / 8))


def test_guesses_are_thinner_and_can_be_left_out() -> None:
    training, (depth,) = scene([camera(0.0)])
    holed = (without(depth, slice(48), slice(32, 64)),)
    counts = {}
    for share in (0.0, 0.3, 1.0):
        options = Stereo(budget=400, detail=0.0, completion=share)
        means = options.build(training, holed, 0, seed=0).means
        assert len(means) == 400
        uv = project(means.double(), training.views[0].camera)[0]
        counts[share] = int((uv[:, 0] > 32).sum())
    assert counts[0.0] == 0
    assert 0.2 < counts[0.3] / (400 - counts[0.3]) < 0.4
    assert 0.9 < counts[1.0] / (400 - counts[1.0]) < 1.1
