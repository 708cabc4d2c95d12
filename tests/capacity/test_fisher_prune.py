"""PUP-3DGS: how many are dropped when, and which."""

from dataclasses import replace

import torch

from framework.types import concatenate
from plugins.capacity.fisher_prune import FisherPrune
from tests.capacity.population import pulls, watched
from tests.plugins.fakes import wall_of_gaussians


def kept_at(step: int, **options: float) -> int | None:
    plugin, ctx = FisherPrune(**options), watched(wall_of_gaussians(100), step)  # type: ignore[arg-type]
    edits, _ = plugin.update(ctx, None, pulls(torch.ones(100)))
    assert edits is None or edits.append is None
    return None if edits is None or edits.keep is None else int(edits.keep.sum())


def test_the_defaults_are_the_papers_shares() -> None:
    assert [step for step in range(100) if kept_at(step) is not None] == [75, 87]
    assert (kept_at(75), kept_at(87)) == (20, 50)
    assert kept_at(50, begin=0.5, rounds=1, first=0.999) == 1


def test_a_short_training_is_pruned_too() -> None:
    plugin = FisherPrune(begin=0.9, rounds=3)
    ctx = replace(watched(wall_of_gaussians(30), 0), n_steps=2)
    edits, _ = plugin.update(ctx, None, pulls(torch.ones(30)))
    assert edits is not None and edits.keep is not None and int(edits.keep.sum()) == 6
    assert FisherPrune(begin=0.97, rounds=1)._steps(30) == [28]  # what is left trains once more


def test_what_no_view_sees_goes_first() -> None:
    wall = wall_of_gaussians(40)
    behind = wall[torch.arange(10)]
    behind = behind.replace(means=-behind.means)
    plugin, ctx = FisherPrune(first=0.2), watched(concatenate([wall, behind]), 75)
    edits, _ = plugin.update(ctx, None, pulls(torch.ones(50)))
    assert edits is not None and edits.keep is not None
    assert edits.keep[:40].all() and not edits.keep[40:].any()
