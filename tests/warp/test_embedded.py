"""Warping on the embedded scene: exact depth must reproduce its ray-traced test images."""

from __future__ import annotations

import torch

from framework.scenes import load_scene
from framework.types import DepthMap, View
from framework.warp import prepare, warp


def _exact(view: View) -> DepthMap:
    assert view.depth is not None
    return DepthMap(view.depth, (view.depth > 0).float())


def test_exact_depth_reproduces_the_interpolating_test_views() -> None:
    scene = load_scene("embedded", {})
    views = scene.training.views
    supports = prepare(views, [_exact(view) for view in views])
    for test in scene.test:
        warped = warp(supports, test.camera)
        error = ((warped.image - test.image) ** 2).mean(0)[warped.mask > 0].mean()
        psnr = float(-10 * torch.log10(error))
        least = 30.0 if "interpolating" in test.tags else 26.0
        assert psnr > least, f"{test.name} {test.tags}: {psnr:.2f} dB, {warped.coverage:.0%}"
