"""The kernels of `sight` against the same rules in torch, on random depth: the same bits."""

import numpy as np
import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.geometry import project, unproject
from framework.initialize.fusion import Mapped, mapped
from framework.initialize.sight import pushed_back, unrepeated
from framework.types import Camera, DepthMap
from tests.init.synthetic import three_views

TOLERANCE, SAME = 0.1, 0.15
STEPS = np.array([1.0, 1.2, 1.5])


def disturbed() -> Mapped:
    """Three views, one of another size, whose depth is off by up to a fifth and full of holes."""
    training, depth = three_views()
    rng = stream(0, "sight")
    maps = []
    for exact in depth:
        shape = tuple(exact.depth.shape)
        off = torch.from_numpy(rng.uniform(0.8, 1.2, shape)).float()
        reference = torch.from_numpy(rng.random(shape) < 0.7).float()
        maps.append(DepthMap(exact.depth * off, reference))
    return mapped(training, maps, 0.5)


def asked(xyz: Tensor, maps: Mapped, v: int, depth: Tensor, tolerance: float) -> tuple[Tensor, ...]:
    """[P] bool twice: view v shows, looks through xyz [P, 3], by the rules in words."""
    camera: Camera = maps.views[v].camera
    uv, z = project(xyz, camera)
    inside = (z > 0) & (uv >= 0).all(1) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    column, row = torch.where(inside[:, None], uv, 0).long().unbind(1)
    nearest = torch.from_numpy(maps.seen.image(maps.seen.nearest, v))[row, column]
    there = depth[row, column]
    shows = inside & (there > 0) & ((z - there).abs() < tolerance * there)
    return shows, inside & nearest.isfinite() & (z < (1 - tolerance) * nearest)


def depth_of(maps: Mapped, v: int) -> Tensor:
    return torch.from_numpy(maps.seen.image(maps.seen.depth, v))


def test_votes() -> None:
    maps = disturbed()
    for v in range(3):
        places, chosen = unrepeated(maps.seen, v, TOLERANCE)
        xyz = unproject(depth_of(maps, v), maps.views[v].camera).reshape(-1, 3)
        votes, repeated = torch.zeros(len(xyz)), torch.zeros(len(xyz), dtype=torch.bool)
        for other in {0, 1, 2} - {v}:
            shows, through = asked(xyz, maps, other, depth_of(maps, other), TOLERANCE)
            votes += shows.float() - through.float()
            repeated |= shows & (other < v)
        expected = (votes >= 0) & ~repeated & (depth_of(maps, v).reshape(-1) > 0)
        np.testing.assert_array_equal(chosen.reshape(-1), expected.numpy())
        np.testing.assert_array_equal(places[chosen], xyz[expected].numpy())
        assert 0 < chosen.sum() < (depth_of(maps, v) > 0).sum()


def test_guesses() -> None:
    maps = disturbed()
    start = np.where(maps.seen.image(maps.seen.depth, 2) > 0, 0.0, 4.5)
    guesses = np.where(maps.seen.depth > 0, 0.0, 5.0)
    center, radius = np.array([0.1, 0.2, 0.3]), 4.5
    near = (guesses, SAME)
    places, depth = pushed_back(maps.seen, 2, start, (center, radius), STEPS, TOLERANCE, near)
    left, expected = torch.from_numpy(start).reshape(-1) > 0, np.zeros(start.size)
    for step in STEPS:
        guess = step * torch.from_numpy(start)
        xyz = unproject(guess, maps.views[2].camera).reshape(-1, 3)
        free = left & ((xyz - torch.from_numpy(center)).square().sum(1).sqrt() >= radius)
        reference = torch.zeros_like(free)
        for other in (0, 1):
            shows, through = asked(xyz, maps, other, depth_of(maps, other), TOLERANCE)
            guessed = torch.from_numpy(maps.seen.image(guesses, other))
            free &= ~through
            reference |= shows | asked(xyz, maps, other, guessed, SAME)[0]
        enters = (free & ~reference).numpy()
        expected[enters] = guess.reshape(-1).numpy()[enters]
        np.testing.assert_array_equal(places.reshape(-1, 3)[enters], xyz[enters].numpy())
        left &= ~free
        assert enters.any() and (free & reference).any()  # there is something to see
    np.testing.assert_array_equal(depth.reshape(-1), expected)
