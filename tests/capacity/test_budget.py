"""A hard number of Gaussians: reached on time, by dropping what the images would not miss."""

from dataclasses import replace

import pytest
import torch

from framework.fisher.scores import removal_energy
from framework.kernels import rasterize
from framework.plugin import StepContext
from framework.toolbox.rounds import training_information
from framework.types import Gaussians, concatenate
from plugins.capacity.budget import Budget
from tests.capacity.population import pulls, watched
from tests.plugins.fakes import wall_of_gaussians


def test_removal_energy_is_the_change_of_the_images() -> None:
    """Rendered with and without a Gaussian, on all views; a few, opaque and faint ones alike."""
    wall = wall_of_gaussians(60)
    subject = wall.replace(opacity_logits=torch.linspace(-3.0, 5.0, 60))
    ctx = watched(subject)
    energy = removal_energy(training_information(ctx).total.diagonal, subject.opacity_logits)
    for index in (0, 20, 40, 50, 59):
        absent = torch.ones(60)
        absent[index] = 0
        change = 0.0
        for view in ctx.views:
            less = rasterize(
                subject, view.camera, background=ctx.background, opacity_factors=absent
            )
            change += float((ctx.render(view.camera).rgb - less.rgb).double().square().sum())
        assert float(energy[index]) == pytest.approx(change, rel=0.06, abs=1e-6), index


def longer(ctx: StepContext) -> StepContext:
    """At the same share of so many more steps that ten epochs lie between rounds."""
    views = len(ctx.views)
    return replace(ctx, n_steps=ctx.n_steps * views, step=(ctx.step + 1) * views - 1)


def count_after(n: int, step: int, **options: float) -> int:
    budget, ctx = Budget(**options), watched(wall_of_gaussians(n), step)  # type: ignore[arg-type]
    edits, state = budget.update(ctx, budget.init_state(ctx), pulls(torch.ones(n)))
    if edits is None:
        return n
    assert edits.keep is not None
    total = int(edits.keep.sum()) + (0 if edits.append is None else len(edits.append))
    assert len(state.total) == total
    return total


def test_the_number_is_reached_at_until_in_equal_ratios() -> None:
    n, counts = 400, []
    for step in range(9, 100, 10):
        n = count_after(n, step, gaussians=100)
        counts.append(n)
    assert counts[5:] == [100] * (len(counts) - 5)  # step 59 = until
    ratios = [b / a for a, b in zip([400, *counts], counts[:6], strict=False)]
    assert max(ratios) - min(ratios) < 0.02


def test_it_drops_what_is_hidden_and_splits_what_is_pulled() -> None:
    everything = watched(wall_of_gaussians(90))
    seen = removal_energy(
        training_information(everything).total.diagonal, everything.gaussians.opacity_logits
    )
    wall = everything.gaussians[seen.argsort(descending=True)[:50]]  # the most telling ones first
    hidden = wall[torch.arange(10)].replace(opacity_logits=torch.full((10,), -9.0))
    subject, strengths = concatenate([wall, hidden]), torch.zeros(60)
    strengths[[3, 7, 55]] = torch.tensor([1.0, 2.0, 3.0])
    budget, ctx = Budget(gaussians=40, grow=0.053), longer(watched(subject, 49))
    edits, _ = budget.update(ctx, budget.init_state(ctx), pulls(strengths))
    assert edits is not None and edits.keep is not None and edits.append is not None
    assert not edits.keep[50:].any() and not edits.keep[[3, 7]].any()
    assert edits.append.means.shape == (4, 3)
    assert moments(edits.append[torch.tensor([1, 3])]) == moments(subject[torch.tensor([7])])


def moments(parts: Gaussians) -> list[float]:
    """Mean and trace of the covariance of a mixture of equals, rounded."""
    mean = parts.means.mean(0)
    spread = parts.scales.square().sum(1).mean() + (parts.means - mean).square().sum(1).mean()
    return [round(float(v), 4) for v in (*mean, spread)]
