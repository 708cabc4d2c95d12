"""The decay of opacities by their gradients, against numbers worked by hand and the trainer's own
decay, and what it changes in a training."""

from typing import Any

import pytest
import torch
from torch import Tensor

from framework.options import TrainerOptions
from framework.plugin import StepStats
from framework.records.progress import Silent
from framework.run.members import IDLE
from framework.run.plane import textured_plane
from framework.train.trainer import Plugins, Trainer
from plugins.capacity.gradient_decay import GradientDecay
from tests.plugins.fakes import Log, context, wall_of_gaussians
from tests.plugins.test_one_step import scattered

PLAIN = {"sh_degree": 1, "opacity_decay": 1.0, "pace_steps": 0, "pace_views": 0}


def trained(steps: int = 1, capacity: Any = None, **options: Any) -> Trainer:
    """A training on three tiny views by this capacity's options, None for a fixed number."""
    plugins = Plugins.of(IDLE if capacity is None else IDLE | {"capacity": capacity})
    training, depth, _ = textured_plane(1)
    settings = TrainerOptions(steps=steps, **{**PLAIN, **options})
    rest = settings, plugins, 0, Silent()
    trainer = Trainer(training, depth, scattered(0), *rest, warns=False)
    trainer.run()
    return trainer


def opacities(of: Trainer) -> Tensor:
    return of.field.params.detach().opacity_logits.double().sigmoid()


def decay(**options: Any) -> dict[str, Any]:
    return {"name": "gradient_decay", **options}


def test_the_factor_is_the_papers() -> None:
    """Computed by hand: opacities 1/2, 1/2, 4/5 and 1/2 with |dL/do| 1, 2, 3 and 0. The mean of
    those above 0 is 2; dL/dlogit is o (1 - o) times dL/do."""
    gaussians = wall_of_gaussians(4).replace(
        opacity_logits=torch.tensor([0.0, 0.0, 1.3862943611198906, 0.0])
    )
    gradient = torch.tensor([0.25, -0.5, 0.48, 0.0])
    log = Log({})
    ctx = context(gaussians=gaussians, log=log)
    stats = StepStats(
        torch.zeros(4, 2), torch.ones(4), 80, 60, gradients={"opacity_logits": gradient}
    )
    edits, state = GradientDecay(decay=0.9, relief=0.5).update(ctx, None, stats)
    assert edits is not None and state is None and not edits.changes_the_rows
    assert set(edits.values) == {"opacity_logits"}
    # 1 - 0.1 e^-0.25, 1 - 0.1 e^-0.5, 1 - 0.1 e^-0.75, 1 - 0.1
    factors = [0.9221199, 0.9393469, 0.9527633, 0.9]
    faded = edits.values["opacity_logits"].double().sigmoid()
    expected = torch.tensor(factors).double() * torch.tensor([0.5, 0.5, 0.8, 0.5])
    assert torch.allclose(faded, expected, atol=1e-6)
    assert log.values["gradient_decay_factor"] == pytest.approx([sum(factors) / 4])
    assert torch.equal(gaussians.opacity_logits[:2], torch.zeros(2))  # what it got is untouched


def test_one_step_is_that_of_the_trainers_own_decay() -> None:
    """An independent computation of the same: all Gaussians here have a gradient, so that the two
    agree on the mean."""
    ours = trained(opacity_decay=0.9, opacity_spare=0.5)
    acted = trained(capacity=decay(decay=0.9, relief=0.5))
    assert torch.allclose(opacities(acted), opacities(ours), atol=1e-6)
    assert not torch.allclose(opacities(acted), opacities(trained(opacity_decay=0.9)), atol=1e-3)
