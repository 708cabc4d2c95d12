"""Warping on the embedded scene: exact depth must reproduce what ray tracing shows."""

import math
from typing import Any

import pytest
import torch

from framework import registry
from framework.toolbox.warping import WarpingAugmenter
from tests.warp.rig import context, embedded, truth

METHODS = [
    name
    for name in sorted(registry.table("augment"))
    if issubclass(registry.lookup("augment", name), WarpingAugmenter)
]
# one photo alone, whose holes neighbours fill, sees less: dB of its pseudo views as measured
LEAST = {"mvs_warp": 27}


def nothing(name: str, value: float) -> None:
    """A log that is not read."""


def augmenter(name: str, **options: Any) -> WarpingAugmenter:
    plugin = registry.build("augment", {"name": name, **options}).plugin
    assert isinstance(plugin, WarpingAugmenter)
    return plugin


def decibels(errors: torch.Tensor) -> float:
    return -10 * math.log10(float(errors.mean()) + 1e-15)


def test_the_truth_is_the_scene_s_own() -> None:
    view = embedded()[0].test[2]
    assert float((truth(view.camera) - view.image).abs().max()) < 1e-6


@pytest.mark.parametrize("name", METHODS)
def test_pseudo_views_show_the_scene(name: str) -> None:
    """The cameras that training really gets, with the default jitter."""
    plugin, state, errors = augmenter(name, every=1), None, []
    for epoch in (0, 2, 4):
        (view,), state = plugin.pseudo_views(context(epoch, nothing), state)
        assert view.mask is not None
        difference = (view.image - truth(view.camera)).double() ** 2
        errors.append(difference.mean(0)[view.mask > 0])
    assert decibels(torch.cat(errors)) > LEAST.get(name, 28)
