"""A training that cannot go on ends at that step and says why; odd input trains or is refused."""

from dataclasses import dataclass
from typing import Any

import pytest
import torch
from torch import Tensor

from framework.options import TrainerOptions
from framework.plugin import Regularizer, StepContext
from framework.records.progress import Silent
from framework.registry import ActivePlugin
from framework.run.plane import textured_plane
from framework.train.guard import Diverged, diverged
from framework.train.optim import Adam
from framework.train.trainer import Plugins, Trained, Trainer
from framework.types import Gaussians, TrainingSet, View
from tests import built
from tests.record.fakes import make_gaussians

OPTIONS = TrainerOptions(steps=6, evaluations=1)


@dataclass(frozen=True)
class SteepLoss(Regularizer):
    """A finite loss whose gradient is not, from step 2 on: sqrt at zero."""

    def loss(self, ctx: StepContext, state: Any, view: View, render: Any) -> Tensor | None:
        return (render.alpha.mean() * 0).sqrt() if ctx.step >= 2 else None


def plugins(**changes: Any) -> Plugins:
    return built.plugins(**{group: ActivePlugin(plugin) for group, plugin in changes.items()})


def train(
    views: TrainingSet | None = None,
    gaussians: Gaussians | None = None,
    options: TrainerOptions = OPTIONS,
    **changes: Any,
) -> Trained:
    plane, depth, start = textured_plane(options.sh_degree)
    chosen = start if gaussians is None else gaussians
    trainer = Trainer(views or plane, depth, chosen, options, plugins(**changes), 0, Silent())
    return trainer.run()


def test_a_gradient_that_is_not_finite_is_caught_at_its_step() -> None:
    with pytest.raises(
        Diverged, match=r"training step 2 on view 'plane-\d': expected finite gradients"
    ) as caught:
        train(reg=SteepLoss())
    state = caught.value.state
    assert not all(torch.isfinite(moment).all() for _, moment in state["adam"].second.items())
    assert "\n" not in str(caught.value) and "trainer.lr_scale" in str(caught.value)
    assert "or repair a plugin's loss term whose derivative is not finite" in str(caught.value)


@pytest.mark.parametrize(
    ("slope", "message"),
    [
        (float("nan"), "finite gradients, got NaN or infinity for 2 Gaussians in 'quats'"),
        (-float("inf"), "finite gradients, got NaN or infinity for 2 Gaussians in 'quats'"),
        (1e20, "gradients below 1e19, got larger ones in 'quats', whose squares overflow"),
    ],
)
def test_a_gradient_is_told_by_what_it_left_in_the_moments(slope: float, message: str) -> None:
    params = make_gaussians(8, 1)
    adam, slopes = Adam(params), params.map(torch.ones_like)
    slopes.quats[2:4] = slope
    broken = adam.step(params, slopes, dict.fromkeys(dict(params.items()), 0.1))
    assert str(diverged(broken, "here", params, adam.state())).startswith(
        f"here: expected {message};"
    )
