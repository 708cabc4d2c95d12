"""`init=stereo` on a scene whose surfaces are known exactly."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.geometry import project
from framework.initialize import Stereo
from framework.initialize.fusion import SurfacePixels, by_centrality, fuse, mapped
from framework.types import DepthMap, Gaussians, TrainingSet
from tests.init.synthetic import BOARD_HALF, BOARD_Z, WALL_Z, camera, scene, three_views


def fused(training: TrainingSet, depth: tuple[DepthMap, ...]) -> SurfacePixels:
    return fuse(mapped(training, depth, detail=0.5), tolerance=0.03)


def rgb(gaussians: Gaussians) -> torch.Tensor:
    return 0.5 + 0.28209479177387814 * gaussians.sh0[:, 0]


def test_all_pixels_lie_on_the_surfaces() -> None:
    xyz = fused(*three_views()).xyz
    z = xyz[:, 2]
    on_board = np.abs(z - BOARD_Z) < 1e-5
    assert (on_board | (np.abs(z - WALL_Z) < 1e-5)).all()
    assert on_board.any() and np.abs(xyz[on_board][:, :2]).max() <= BOARD_HALF + 1e-5


def test_the_central_view_comes_first_and_whole() -> None:
    training, depth = three_views()
    middle = training.views[1]
    assert by_centrality([view.camera for view in training.views])[0] == 1
    n = middle.camera.width * middle.camera.height
    uv, _ = project(torch.from_numpy(fused(training, depth).xyz[:n]), middle.camera)
    corners = uv.min(0).values.tolist() + uv.max(0).values.tolist()
    assert corners == pytest.approx(
        [0.5, 0.5, middle.camera.width - 0.5, middle.camera.height - 0.5]
    )


def test_each_surface_enters_once() -> None:
    view = camera(0.0)
    once, twice = fused(*scene([view])), fused(*scene([view, view]))
    assert len(once.xyz) == len(twice.xyz) == view.width * view.height
    # three views overlap by far the most, so the union is only a little more than one of them
    assert len(fused(*three_views()).xyz) < 2.2 * view.width * view.height


def test_later_views_add_what_earlier_ones_cannot_see() -> None:
    training, depth = three_views()
    xyz = torch.from_numpy(fused(training, depth).xyz)
    uv, _ = project(xyz, training.views[1].camera)
    middle = training.views[1].camera
    outside = (uv < 0).any(1) | (uv[:, 0] >= middle.width) | (uv[:, 1] >= middle.height)
    assert outside.sum() > 500
    board = project(torch.tensor([[BOARD_HALF, 0.0, BOARD_Z]], dtype=torch.float64), middle)[0]
    behind = ~outside & (xyz[:, 2] > WALL_Z - 1e-5) & ((uv - board).abs() < 4).all(1)
    assert behind.sum() > 3  # the wall that the board hides from the middle view


def test_what_most_views_look_through_is_removed() -> None:
    training, depth = three_views()
    floating = depth[0].depth.clone()
    floating[20:26, 30:36] = 2.0
    spoiled = (DepthMap(floating, depth[0].confidence), *depth[1:])
    assert (fused(training, spoiled).xyz[:, 2] > 3).all()


def test_unconfident_unknown_and_masked_pixels_stay_out() -> None:
    training, (depth,) = scene([camera(0.0)])
    confidence, values, mask = torch.ones(48, 64), depth.depth.clone(), torch.ones(48, 64)
    confidence[:, :10] = 0
    values[:, 10:20] = 0
    values[0, 20] = float("nan")
    mask[:, 60:] = 0
    masked = replace(training, views=(replace(training.views[0], mask=mask),))
    pixels = fused(masked, (DepthMap(values, confidence),))
    assert len(pixels.xyz) == 48 * 40 - 1
    uv, _ = project(torch.from_numpy(pixels.xyz), training.views[0].camera)
    assert uv[:, 0].min() > 20 and uv[:, 0].max() < 60


def test_exactly_the_budget_with_the_colours_of_the_pixels() -> None:
    training, depth = three_views()
    gaussians = Stereo(budget=700).build(training, depth, sh_degree=2, seed=0)
    assert len(gaussians) == 700 and gaussians.sh_degree == 2
    pixels = fused(training, depth)
    row = {tuple(p): c for p, c in zip(pixels.xyz.astype(np.float32), pixels.rgb, strict=True)}
    expected = np.stack([row[tuple(p)] for p in gaussians.means.numpy()])
    np.testing.assert_allclose(rgb(gaussians).numpy(), expected, atol=1e-6)
    assert (gaussians.shN == 0).all() and (gaussians.quats == torch.tensor([1.0, 0, 0, 0])).all()
    torch.testing.assert_close(gaussians.opacities, torch.full((700,), 0.1))
    assert all(t.dtype == torch.float32 and t.is_contiguous() for _, t in gaussians.items())


def test_the_gaussians_cover_the_surface_at_any_budget() -> None:
    """Sum of (s / factor)^2 estimates the area of all pixels without bias (Horvitz-Thompson)."""
    training, depth = three_views()
    area = np.square(fused(training, depth).size).sum()
    for budget in (500, 1500):
        options = Stereo(budget=budget, scale_factor=1.3)
        scales = options.build(training, depth, 0, seed=0).scales[:, 0].double()
        assert float((scales / 1.3).square().sum()) == pytest.approx(area, rel=0.05)
