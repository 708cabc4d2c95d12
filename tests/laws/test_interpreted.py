"""Compiled kernels compute what their source says: as Python itself, which runs it line by line."""

from collections.abc import Callable
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from numba.core.registry import CPUDispatcher

from framework.depth import consistency, providers
from framework.depth.matching import aggregate, match, sweep
from framework.initialize import Stereo, completion, fusion, sight
from framework.kernels import binocular, roughness
from framework.scenes.embedded import shade, solids, trace
from framework.warp import kernels, zbuffer
from tests.depth import plane
from tests.init import synthetic
from tests.numerics import test_binocular, test_roughness
from tests.warp import rig, stage

PLACES = ((-0.6, 0.0, 0.0), (0.0, 0.1, 0.0), (0.5, 0.0, 0.1))


def traced() -> list[torch.Tensor]:
    return [rig.truth(stage.camera(0.3, size=(12, 9)))]


def swept() -> list[torch.Tensor]:
    cameras = [plane.camera(place, (14, 10), 16.0) for place in PLACES]
    views = tuple(plane.view(str(i), camera) for i, camera in enumerate(cameras))
    training = replace(plane.plane_scene(), views=views)
    maps = providers.PlaneSweep(planes=6, radius=1).estimate(training)
    return [part for one in maps for part in (one.depth, one.confidence)]


def warped() -> list[torch.Tensor]:
    views = [stage.photograph(stage.camera(x, size=(20, 15))) for x in (-0.5, 0.5)]
    target = stage.camera(0.1, 0.0, 0.2, size=(20, 15))
    supports = zbuffer.prepare(views, [stage.exact(view) for view in views])
    seen = zbuffer.warp(supports, target)
    return [seen.image, seen.mask, seen.depth]


def fused() -> list[torch.Tensor]:
    cameras = [synthetic.camera(x, -x / 10, 20, 15) for x in (-0.6, 0.05, 0.7)]
    training, depth = synthetic.scene(cameras)
    holes = [replace(one, confidence=(one.depth > 5).float()) for one in depth]
    return [Stereo(budget=99).build(training, holes, 0, 0).means]


def smoothed() -> list[np.ndarray]:
    alpha, depth, weights = (t.numpy() for t in test_roughness.drawn(1, 12, 20))
    return list(roughness.roughness_gradient(alpha, depth, weights))


def seen_from_beside() -> list[np.ndarray]:
    alpha, depth, shifted, photo = test_binocular.drawn(1, 12, 20)
    seen = tuple(t.numpy() for t in (shifted.rgb, shifted.alpha, shifted.depth))
    inputs = alpha.numpy(), depth.numpy(), seen, photo.numpy(), np.ones((12, 20), np.float32)
    return list(binocular.binocular_gradient(*inputs, -3.7, 0.2, 0.3))


@pytest.mark.parametrize(
    ("compute", "modules"),
    [
        (traced, (solids, shade, trace, rig)),
        (swept, (match, aggregate, sweep, consistency, providers)),
        (warped, (kernels, zbuffer)),
        (fused, (sight, fusion, completion)),
        (smoothed, (roughness,)),
        (seen_from_beside, (binocular, roughness)),
    ],
)
def test_python_computes_the_same(
    compute: Callable[[], list[Any]],
    modules: tuple[ModuleType, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    expected = compute()
    for module in modules:
        for name, value in list(vars(module).items()):
            if isinstance(value, CPUDispatcher):
                monkeypatch.setattr(module, name, value.py_func)
    for ours, theirs in zip(compute(), expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1 / 255)
