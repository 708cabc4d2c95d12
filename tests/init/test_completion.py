"""Guesses where depth is missing: they continue what is around, behind all that others see."""

import numpy as np
import pytest
import torch

from framework.geometry import project
from framework.initialize.completion import BALL, complete, filled
from framework.initialize.fusion import SurfacePixels, mapped
from framework.types import DepthMap, TrainingSet
from tests.init.synthetic import WALL_Z, camera, scene


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


def test_a_hole_in_a_plane_is_closed_on_the_plane() -> None:
    training, (depth,) = scene([camera(0.0)])
    pixels = completed(training, (without(flat(depth, WALL_Z), slice(20, 30), slice(5, 15)),))
    assert len(pixels.xyz) == 100
    np.testing.assert_allclose(pixels.xyz[:, 2], WALL_Z, rtol=1e-6)
    uv = project(torch.from_numpy(pixels.xyz), training.views[0].camera)[0].numpy()
    np.testing.assert_allclose(uv.min(0), [5.5, 20.5], atol=1e-6)
    rgb = training.views[0].image[:, 20, 5].numpy()
    np.testing.assert_array_equal(pixels.rgb[0], rgb)


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


@pytest.mark.parametrize("shape", [(1, 1), (7, 13), (48, 64)])
def test_filling_keeps_the_known_and_stays_between(shape: tuple[int, int]) -> None:
    depth = np.zeros(shape)
    assert (filled(depth) == 0).all()
    depth[0, 0], depth[-1, -1] = 2.0, 8.0
    result = filled(depth)
    assert result[-1, -1] == 8.0
    assert (result >= 2.0 - 1e-9).all() and (result <= 8.0 + 1e-9).all()
