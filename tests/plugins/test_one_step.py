"""What capacities of two fields change in one step of a training.

On three tiny views, in the second of two steps: Adam's first one depends on the gradient's sign
only, and some methods begin with nothing. Photos weigh nothing beside a loss term, so that what
moves is what the term pulls at.
"""

from dataclasses import replace
from typing import Any

import torch

from framework.compute.rng import stream
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.run.members import IDLE
from framework.run.plane import textured_plane
from framework.train.field import Field
from framework.train.trainer import Plugins, Trainer
from framework.types import Gaussians


def scattered(seed: int) -> Gaussians:
    """Gaussians before the plane of which no two are alike."""
    draws = stream(seed, "scattered")
    return textured_plane(1)[2].map(
        lambda t: t + 0.1 * torch.from_numpy(draws.standard_normal(tuple(t.shape))).float()
    )


def trained(weight: float = 1.0, steps: int = 2, **options: dict[str, Any]) -> Trainer:
    """A training by the plugins of these options, on photos of this weight. A second field begins
    elsewhere than the first."""
    training, depth, _ = textured_plane(1)
    views = tuple(replace(view, weight=weight) for view in training.views)
    tilt = torch.linspace(0.99, 1.01, views[0].camera.width)  # of a flat one nothing correlates
    depth = tuple(replace(each, depth=each.depth * tilt) for each in depth)
    chosen = {group: ours | options.get(group, {}) for group, ours in IDLE.items()}
    trainer = Trainer(
        replace(training, views=views),
        depth,
        scattered(0),
        TrainerOptions(
            steps=steps, sh_degree=1, sh_every=1, opacity_decay=1.0, depth_smoothness=0.0
        ),
        Plugins.of(chosen),
        0,
        Silent(),
        warns=False,
        second=scattered(1),
    )
    trainer.run()
    return trainer


def changed(before: Gaussians, after: Gaussians) -> set[str]:
    """The names of the tensors that are not the same."""
    pairs = zip(before.items(), after.items(), strict=True)
    return {name for (name, one), (_, other) in pairs if not torch.equal(one, other)}


def rested_and_acted(steps: int, **options: Any) -> tuple[Trainer, Trainer]:
    """Two trainings of two fields, with a capacity that never acts and one that always does."""
    rested, acted = (
        trained(steps=steps, capacity={**options, "start": 0.0, "stop": stop})
        for stop in (0.0, 1.0)
    )
    return rested, acted


def second(trainer: Trainer) -> Field:
    assert trainer.second is not None
    return trainer.second


def test_co_pruning_leaves_in_both_fields_what_the_other_has() -> None:
    """All distances in float64 between the fields after the step."""
    rested, acted = rested_and_acted(1, name="co_prune", distance=0.5, every=1.0)
    one, other = rested.field.params.detach(), second(rested).params.detach()
    apart = torch.cdist(one.means.double(), other.means.double())
    for axis, before, after in ((1, one, acted.field), (0, other, second(acted))):
        keep = apart.min(axis).values <= 0.5 * acted.extent
        assert 0 < int(keep.sum()) < len(before)
        assert not changed(before[keep], after.params)
        assert len(after.optimizer.state().first) == len(after.params)


def test_self_ensemble_shakes_the_second_field_alone() -> None:
    """With the third of its looks; of a Gaussian that is shaken all that is noisy is, and neither
    the first field nor what the optimizer knows is touched."""
    rested, acted = rested_and_acted(3, name="self_ensemble", cameras=2, uncertain=0.5, least=0.0)
    assert not changed(rested.field.params, acted.field.params)
    before, after = second(rested), second(acted)
    shaken = {"means", "log_scales", "opacity_logits"}
    assert changed(before.params, after.params) == shaken
    rows = [
        (getattr(before.params, name) != getattr(after.params, name)).view(200, -1).any(1)
        for name in sorted(shaken)
    ]
    assert all(torch.equal(row, rows[0]) for row in rows) and 0 < int(rows[0].sum()) < 200
    reference = before.optimizer.state(), after.optimizer.state()
    assert not changed(reference[0].first, reference[1].first) | changed(
        reference[0].second, reference[1].second
    )
