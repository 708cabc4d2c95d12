"""A hard number of Gaussians: reached on time, by dropping what the images would not miss."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from framework.errors import UserError
from framework.fisher.scores import removal_energy
from framework.kernels import rasterize
from framework.plugin import StepContext
from framework.registry import build
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


@pytest.mark.parametrize(
    ("steps", "views", "interval"), [(300, 3, 30), (300, 43, 45), (75, 64, 45), (300, 100, 180)]
)
def test_many_views_have_rounds_an_epoch_apart_and_one_at_until(
    steps: int, views: int, interval: int
) -> None:
    """A round looks at every view, so rounds by share alone would cost more than the training."""
    ctx = watched()
    many = replace(ctx, n_steps=steps, views=(ctx.views * views)[:views])
    due = [
        step + 1
        for step in range(steps)
        if (step + 1) % Budget()._interval(replace(many, step=step)) == 0
    ]
    assert due[0] == interval and 0.6 * steps in due


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


def test_a_late_start_reaches_it_at_once_and_few_grow_to_it() -> None:
    assert count_after(400, 59, gaussians=100) == 100
    assert count_after(400, 69, gaussians=100) == 100
    assert count_after(40, 19, gaussians=100) == 50
    assert count_after(90, 19, gaussians=100) == 100
    assert count_after(1, 19, gaussians=100) == 2
    assert count_after(400, 20, gaussians=100) == 400  # between rounds


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


def test_rounds_of_few_epochs_split_less() -> None:
    """A hundred steps, a round every ten: ten epochs with one view, five with two."""
    ctx, split = watched(wall_of_gaussians(60), 9), []
    for n in (1, 2, 4):
        seen, budget = replace(ctx, views=ctx.views[:1] * n), Budget(gaussians=40)
        edits, _ = budget.update(seen, budget.init_state(seen), pulls(torch.ones(60)))
        assert edits is not None and edits.append is not None and edits.keep is not None
        assert int(edits.keep.sum()) + len(edits.append) == 56
        split.append(len(edits.append) // 2)
    assert split == [28, 11, 3]  # all, a quarter and a sixteenth of those kept


def moments(parts: Gaussians) -> list[float]:
    """Mean and trace of the covariance of a mixture of equals, rounded."""
    mean = parts.means.mean(0)
    spread = parts.scales.square().sum(1).mean() + (parts.means - mean).square().sum(1).mean()
    return [round(float(v), 4) for v in (*mean, spread)]


def test_options_are_checked() -> None:
    for option, value in (("gaussians", 0), ("every", 0.0), ("grow", 2.0), ("until", -1.0)):
        with pytest.raises(UserError, match=rf"capacity.{option}: expected "):
            build("capacity", {"name": "budget", option: value})
    for late in ({"every": 0.7}, {"start": 0.72}, {"every": 0.5, "start": 0.55}):
        with pytest.raises(UserError, match=r"expected a round after start and up to until"):
            build("capacity", {"name": "budget", **late})
    build("capacity", {"name": "budget", "every": 0.2, "until": 0.6, "start": 0.5})
    with pytest.raises(UserError, match=r"expected until <= stop, .* until=0.6, stop=0.5"):
        build("capacity", {"name": "budget", "stop": 0.5})
