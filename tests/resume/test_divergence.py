"""A training that cannot go on ends at that step and says why; odd input trains or is refused."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from framework import registry
from framework.errors import UserError
from framework.initialize import INITIALIZERS
from framework.kernels import losses
from framework.kernels.losses import photometric_gradient
from framework.options import TrainerOptions
from framework.plugin import Capacity, Edits, Regularizer, StepContext, StepStats
from framework.records.progress import Silent
from framework.registry import ActivePlugin
from framework.run import training
from framework.run.plane import textured_plane
from framework.train.guard import Diverged, diverged
from framework.train.optim import Adam
from framework.train.optimizer import AdamState
from framework.train.resume.checkpoint import unpack
from framework.train.trainer import Plugins, Trained, Trainer
from framework.types import Gaussians, Scene, TrainingSet, View
from tests import built
from tests.built import build_provider
from tests.record.fakes import make_gaussians

OPTIONS = TrainerOptions(steps=6, evaluations=1)


@dataclass(frozen=True)
class SteepLoss(Regularizer):
    """A finite loss whose gradient is not, from step 2 on: sqrt at zero."""

    def loss(self, ctx: StepContext, state: Any, view: View, render: Any) -> Tensor | None:
        return (render.alpha.mean() * 0).sqrt() if ctx.step >= 2 else None


@dataclass(frozen=True)
class BrokenChildren(Capacity):
    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits, Any]:
        child = ctx.gaussians[torch.tensor([0])]
        return Edits(append=child.replace(quats=child.quats * float("nan"))), state


@dataclass(frozen=True)
class NoChildren(Capacity):
    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits, Any]:
        return Edits(append=ctx.gaussians[torch.tensor([], dtype=torch.long)]), state


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


def test_a_capacity_may_add_no_gaussian() -> None:
    assert len(train(capacity=NoChildren()).gaussians) == 200


def test_a_gradient_that_is_not_finite_is_caught_at_its_step() -> None:
    with pytest.raises(
        Diverged, match=r"training step 2 on view 'plane-\d': expected finite gradients"
    ) as caught:
        train(reg=SteepLoss())
    state = caught.value.state
    assert not all(torch.isfinite(moment).all() for _, moment in state["adam"].second.items())
    assert "\n" not in str(caught.value) and "trainer.lr_scale" in str(caught.value)
    assert "or repair a plugin's loss term whose derivative is not finite" in str(caught.value)


def test_so_is_one_that_goes_straight_into_the_update(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a regularizer's loss term, as most trainings."""
    taken = []

    def steep(*inputs: Any) -> tuple[float, np.ndarray]:
        loss, image = photometric_gradient(*inputs)
        taken.append(loss)
        return loss, image * np.float32("nan") if len(taken) == 3 else image

    monkeypatch.setattr(losses, "photometric_gradient", steep)
    with pytest.raises(Diverged, match=r"training step 2 on view 'plane-\d': expected finite grad"):
        train()
    assert len(taken) == 3


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


def test_what_a_capacity_adds_is_checked() -> None:
    with pytest.raises(Diverged, match=r"step 0: expected the capacity plugin.*'quats' of 1"):
        train(capacity=BrokenChildren())


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e20])
@pytest.mark.parametrize("where", [0, 63])
def test_the_optimizer_names_what_is_not_finite(bad: float, where: int) -> None:
    params = make_gaussians(64, 1)
    grads = params.map(torch.ones_like)
    rates = dict.fromkeys(dict(params.items()), 0.1)
    assert Adam(params).step(params, grads, rates) == ()
    grads.log_scales[where, 1] = bad
    assert Adam(params).step(params, grads, rates) == ("log_scales",)


def test_a_parameter_that_overflows_is_caught() -> None:
    params = make_gaussians(8, 0)
    params.means[3] = 3.4e38
    grads = params.map(lambda t: -torch.ones_like(t))
    adam = Adam(params)
    broken = adam.step(params, grads, {n: 3e37 for n, _ in params.items()})
    assert broken[0] == "means"
    message = str(diverged(broken, "here", params, adam.state()))
    assert "finite parameters, got NaN or infinity for 1 Gaussians in 'means'" in message


def test_the_state_is_left_for_inspection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    views, depth, gaussians = textured_plane(0)
    chosen = plugins(reg=SteepLoss())
    monkeypatch.setattr(registry, "build", lambda group, config: chosen.each[group])
    config = {"augment": {}, "reg": {}, "capacity": {}, "seed": 0, "trainer": asdict(OPTIONS)}
    run = training.Run(
        Scene("plane", "own", views, (), "f"), depth, lambda _: gaussians, tmp_path, "id", False
    )
    with pytest.raises(UserError, match=r"the state is in .*diverged\.safetensors$"):
        training.train(run, config, Silent())
    identity, state = unpack(tmp_path / "diverged.safetensors", [Gaussians, AdamState])
    assert identity == "id" and state["where"].startswith("training step 2")
    assert state["gaussians"].means.shape == state["adam"].first.means.shape


def test_no_gaussians_to_start_from() -> None:
    nothing = textured_plane(0)[2][torch.zeros(0, dtype=torch.int64)]
    with pytest.raises(UserError, match="expected Gaussians to start from, got none"):
        train(gaussians=nothing)


def plain_views(value: float) -> TrainingSet:
    """The plane with images of one colour."""
    views = textured_plane(0)[0]
    flat = (replace(view, image=torch.full_like(view.image, value)) for view in views.views)
    return replace(views, views=tuple(flat))


def test_images_without_texture_have_no_depth_to_start_from() -> None:
    """The default pipeline reports that nothing matched, or starts from what it found."""
    views = plain_views(0.5)
    depth = build_provider("plane_sweep", {}).estimate(views)
    try:
        gaussians = INITIALIZERS["stereo"]().build(views, depth, 0, 0)
    except UserError as error:
        assert "init=stereo: expected at least" in str(error) and "\n" not in str(error)
    else:
        assert all(torch.isfinite(tensor).all() for _, tensor in gaussians.items())


def test_a_rate_too_high_never_ends_with_broken_gaussians() -> None:
    """Either it is reported, or the result is finite."""
    options = TrainerOptions(**{**asdict(OPTIONS), "steps": 40, "lr_scale": 999.0})
    try:
        trained = train(options=options)
    except Diverged as error:
        assert "trainer.lr_scale" in str(error)
    else:
        assert all(torch.isfinite(tensor).all() for _, tensor in trained.gaussians.items())
