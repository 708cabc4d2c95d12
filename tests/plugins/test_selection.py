"""How the warping methods choose their supports; all else is shared (see `test_safi.py`)."""

import dataclasses

import pytest

from framework import registry
from framework.toolbox.warping import WarpingAugmenter, center_distances
from plugins.augment.dba import Dba
from plugins.augment.euclidean import Euclidean
from plugins.augment.full_set import FullSet
from plugins.augment.safi import Safi
from tests.plugins.fakes import context, stage
from tests.warp.stage import camera

METHODS: list[type[WarpingAugmenter]] = [Dba, Euclidean, FullSet, Safi]
# the stage's training cameras are at (-0.5, 0), (0.5, 0.1) and (0, -0.4)


def chosen(plugin: WarpingAugmenter, x: float, y: float, **pose: float) -> list[int]:
    target = camera(x, y, size=(80, 60), **pose)  # type: ignore[arg-type]
    return plugin.select(context(), None, target)[0]


def test_dba_takes_the_closest_view_alone() -> None:
    assert chosen(Dba(), -0.4, 0.0) == [0]
    assert chosen(Dba(), 0.3, 0.1) == [1]
    assert chosen(Dba(), 0.0, -0.2) == [2]


def test_euclidean_keeps_safi_s_threshold_rule() -> None:
    """Distances from (0.1, 0): 0.6, 0.412 and 0.412."""
    distances = center_distances(stage()[0], camera(0.1, 0.0))
    assert distances == pytest.approx([0.6, 0.1700**0.5, 0.1700**0.5])
    assert chosen(Euclidean(eta=1.4), 0.1, 0.0) == [1, 2]
    assert chosen(Euclidean(eta=1.5), 0.1, 0.0) == [0, 1, 2]
    assert chosen(Euclidean(eta=1e6), -0.5, 0.0) == [0]  # a distance of 0 tolerates no other


@pytest.mark.parametrize("plugin", [Dba(), Euclidean()], ids=["dba", "euclidean"])
def test_distance_is_between_centres_and_not_translations(plugin: WarpingAugmenter) -> None:
    """A turned camera has another translation column, but stands where it stood."""
    for yaw in (0.0, 0.5, 3.0):
        assert chosen(plugin, -0.45, 0.0, yaw=yaw) == [0]
        assert chosen(plugin, 0.48, 0.1, yaw=yaw) == [1]


def test_shared_options_have_the_same_defaults() -> None:
    """Otherwise a comparison would be one of options."""
    rows = [{n: f.default for n, _, f in registry.option_fields(method)} for method in METHODS]
    for key in set().union(*rows):
        assert len({row[key] for row in rows if key in row}) == 1, key
    common = {field.name for field in dataclasses.fields(WarpingAugmenter)}
    assert all(common <= set(row) for row in rows)
