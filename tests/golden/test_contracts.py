"""What methods of the literature need: several plugins, a second field, other renders, steps and
gradients."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from framework import registry
from framework.errors import UserError
from framework.options import TrainerOptions
from framework.plugin import (
    Capacity,
    Edits,
    GradientAt,
    Regularizer,
    StepContext,
    StepStats,
    SubStep,
)
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.registry import ActivePlugin
from framework.run.plane import textured_plane
from framework.train.descent import Fading, fade
from framework.train.field import apply_edits, rows_after
from framework.train.optim import Adam
from framework.train.plugin_calls import _moved
from framework.train.resume.checkpoint import pack, state_classes, unpack
from framework.train.resume.training_state import TrainerState
from framework.train.trainer import Trainer
from framework.types import Gaussians, Render, View
from tests.built import plugins


def several(group: str, *chosen: Any) -> dict[str, ActivePlugin]:
    """Several plugins of a group, as the command line joins them."""
    return {f"{group}.{type(one).__name__}": ActivePlugin(one) for one in chosen}


def trainer(
    keeper: Any = None, start: Any = None, options: Any = None, second: Any = None, **chosen: Any
) -> Trainer:
    settings = {"steps": 4, "evaluations": 1, "coarse_factor": 1, **(options or {})}
    training, depth, gaussians = textured_plane(0)
    options = TrainerOptions(**settings)
    of = (training, depth, gaussians, options, plugins(**chosen), 0, Silent())
    return Trainer(*of, keeper=keeper, start=start, warns=False, second=second)


def bits(of: Trainer) -> str:
    return parameters_sha256(of.run().gaussians)


@dataclass(frozen=True)
class Half(Regularizer):
    """Halves opacities."""

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        return torch.full((len(ctx.gaussians),), 0.5), (state or 0) + 1


@dataclass(frozen=True)
class Quarter(Half):
    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        return torch.full((len(ctx.gaussians),), 0.25), state


def test_several_regularizers_multiply_and_each_has_its_state() -> None:
    both = trainer(reg=several("reg", Half(), Half2()))
    assert bits(both) == bits(trainer(reg=ActivePlugin(Quarter())))
    kept = both.state().field.plugins
    assert {k: v.value for k, v in kept.items() if k.startswith("reg")} == {
        "reg.Half": 4,
        "reg.Half2": 4,
    }


@dataclass(frozen=True)
class Half2(Half):
    pass


@dataclass(frozen=True)
class Elsewhere(Regularizer):
    """An extra render in the loss: from another camera, with factors, with parts detached."""

    names: tuple[str, ...] = ()

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor:
        parts = {name: getattr(ctx.gaussians, name).detach() for name in self.names}
        factors = torch.full((len(ctx.gaussians),), 0.5)
        seen = ctx.render(
            ctx.views[-1].camera, ctx.gaussians.replace(**parts), opacity_factors=factors
        )
        return seen.rgb.square().mean() * 100


def test_a_loss_may_render_from_elsewhere_and_leave_parts_alone() -> None:
    plain = trainer().run().gaussians
    moved = trainer(reg=ActivePlugin(Elsewhere())).run().gaussians
    assert not torch.equal(plain.opacity_logits, moved.opacity_logits)
    names = tuple(name for name, _ in plain.items())
    with pytest.raises(UserError, match="without a gradient"):
        trainer(reg=ActivePlugin(Elsewhere(names))).run()
    first = {"steps": 1, "lr_final": 1.0}
    plain = trainer(options=first).run().gaussians
    alone = trainer(reg=ActivePlugin(Elsewhere(("means",))), options=first).run().gaussians
    assert torch.allclose(plain.means, alone.means, atol=1e-6)
    assert not torch.equal(plain.sh0, alone.sh0)


@dataclass(frozen=True)
class Sub(Regularizer):
    """Two extra steps; the second sees the result of the first."""

    def substeps(self, ctx: StepContext, state: Any, view: View) -> Iterator[SubStep]:
        before = ctx.gaussians.means.detach().clone()
        yield ctx.gaussians.means.square().sum(), ("means",)
        assert not torch.equal(ctx.gaussians.means, before)
        yield ctx.gaussians.opacity_logits.sum(), ["opacity_logits"]


def test_a_regularizer_may_take_steps_of_its_own() -> None:
    plain, ours = trainer(), trainer(reg=ActivePlugin(Sub()))
    before, after = plain.run().gaussians, ours.run().gaussians
    assert ours.state().dose["substeps"] == (8, 0.0)
    steps = ours.field.optimizer.state().steps
    assert steps[0] == 8 and steps[1] == 4 and steps[3] == 8
    assert after.opacity_logits.mean() < before.opacity_logits.mean()


@dataclass(frozen=True)
class Again(Regularizer):
    """The gradient elsewhere; at the parameters themselves it is the same."""

    shift: float = 0.0

    def gradient(
        self, ctx: StepContext, state: Any, actual: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor]:
        return at(ctx.gaussians.replace(means=ctx.gaussians.means + self.shift))


def test_a_gradient_may_be_taken_elsewhere() -> None:
    assert bits(trainer()) == bits(trainer(reg=ActivePlugin(Again())))
    assert bits(trainer()) != bits(trainer(reg=ActivePlugin(Again(0.1))))
    with_loss = several("reg", Elsewhere(), Again())
    assert bits(trainer(reg=ActivePlugin(Elsewhere()))) == bits(trainer(reg=with_loss))


@dataclass(frozen=True)
class Dim(Regularizer):
    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[None, Any]:
        return None, 0.5

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: float) -> Gaussians:
        return gaussians.replace(opacity_logits=gaussians.opacity_logits - state)


def test_what_is_evaluated_may_differ_from_what_is_trained() -> None:
    plain, dim = trainer(), trainer(reg=ActivePlugin(Dim()))
    logits = plain.run().gaussians.opacity_logits
    assert torch.equal(dim.run().gaussians.opacity_logits, logits - 0.5)
    assert torch.equal(dim.field.params.opacity_logits, logits)


@dataclass(frozen=True)
class Watch(Capacity):
    """Notes what it is shown; removes a Gaussian and adds another one in every step."""

    gradients: ClassVar[tuple[str, ...]] = ("opacity_logits",)

    def init_state(self, ctx: StepContext) -> Any:
        return torch.arange(len(ctx.gaussians)), 0

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits, Any]:
        rows, seen = state
        assert len(rows) == len(ctx.gaussians) == len(stats.radii) == len(stats.means2d_grad)
        assert stats.view is not None and set(stats.gradients) == {"opacity_logits"}
        assert stats.gradients["opacity_logits"].shape == stats.radii.shape
        keep = torch.ones(len(rows), dtype=torch.bool)
        keep[1] = False
        values = {"opacity_logits": ctx.gaussians.opacity_logits - 1}
        new = ctx.gaussians.rows(0, 1)
        rows = torch.cat([rows[keep], torch.tensor([-1])])
        return Edits(keep=keep, append=new, values=values), (rows, seen + 1)

    def followed(self, state: Any, rows: Tensor) -> Any:
        old = state[0][rows.clamp(min=0)]
        return torch.where(rows >= 0, old, -1), state[1]


@dataclass(frozen=True)
class Watch2(Watch):
    pass


def test_several_capacities_follow_each_other() -> None:
    training = trainer(capacity=several("capacity", Watch(), Watch2()))
    training.run()
    states = [training.state().field.plugins[f"capacity.{name}"] for name in ("Watch", "Watch2")]
    # the second begins with what the first left of its first step
    first, n = states[0].value[0], len(states[0].value[0])
    began = torch.cat([torch.tensor([0]), torch.arange(2, n), torch.tensor([-1, -1])])
    assert torch.equal(first, began[states[1].value[0]])
    assert states[0].value[1] == states[1].value[1] == 4
    assert (states[0].value[0] == -1).sum() == 8 and training.state().field.version == 8


def test_new_values_keep_the_moments_and_rows_are_told() -> None:
    gaussians = textured_plane(1)[2].rows(0, 4)
    optimizer = Adam(gaussians)
    optimizer.step(gaussians, {n: torch.ones_like(t) for n, t in gaussians.items()}, RATES)
    moments = optimizer.state().first.opacity_logits.clone()
    logits = torch.tensor([1.0, 2.0, 3.0, 4.0])
    keep = torch.tensor([True, False, True, True])
    bands = torch.tensor([False, True, True, False])
    new = gaussians.rows(0, 1)
    edits = Edits(keep=keep, append=new, bands=bands, values={"opacity_logits": logits})
    after = apply_edits(gaussians, optimizer, edits, "here")
    rows = rows_after(gaussians, edits)
    assert rows.tolist() == [2, -1, 0, 3] and after.opacity_logits.tolist()[0] == 3
    assert after.opacity_logits[2:].tolist() == [1, 4]
    assert torch.equal(optimizer.state().first.opacity_logits[rows >= 0], moments[rows[rows >= 0]])


RATES = dict.fromkeys(("means", "quats", "log_scales", "opacity_logits", "sh0", "shN"), 0.1)


@dataclass(frozen=True)
class Pair(Regularizer):
    """Compares with a second field."""

    second_field: ClassVar[bool] = True

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor:
        assert ctx.other is not None and not ctx.other.means.requires_grad
        other = ctx.render(view.camera, ctx.other, background=ctx.behind)
        return (ctx.render(view.camera, ctx.gaussians).rgb - other.rgb).abs().mean()


@dataclass
class Keeper:
    """Keeps the state after one step."""

    at: int
    state: Any = None

    def due(self) -> bool:
        return True

    def keep(self, state: TrainerState) -> None:
        if state.step == self.at:
            self.state = pack(state, state_classes([Pair()]), "id", "test")


def test_a_second_field_has_parameters_draws_and_capacity_of_its_own(tmp_path: Any) -> None:
    uniform = registry.build("reg", {"name": "uniform", "p": 0.3, "schedule": "constant"})
    chosen = {"reg": {"reg.uniform": uniform, "reg.Pair": ActivePlugin(Pair())}}
    keeper = Keeper(2)
    whole = trainer(keeper, capacity=ActivePlugin(Watch()), **chosen)
    actual = bits(whole)
    assert whole.second is not None
    assert not torch.equal(whole.second.params.means, whole.field.params.means)
    assert len(whole.second.params) == len(whole.field.params)
    assert trainer(**chosen).second is not None and trainer().second is None
    path = tmp_path / "state.safetensors"
    path.write_bytes(keeper.state)
    state = unpack(path, state_classes([Pair()]), "id")[1]
    assert bits(trainer(start=state, capacity=ActivePlugin(Watch()), **chosen)) == actual


def test_what_the_photos_hold_on_to_fades_less() -> None:
    """Computed by hand: opacity 1/2, gradients in it 0, 1, 2 and so 0, 1, 2 times their mean."""
    gaussians = textured_plane(0)[2].rows(0, 3).replace(opacity_logits=torch.zeros(3))
    fade(gaussians, torch.tensor([0.0, 0.25, -0.5]), Fading(decay=0.9, spare=0.5))
    expected = 0.5 * (1 - 0.1 * (-0.5 * torch.tensor([0.0, 1.0, 2.0])).exp())
    assert torch.allclose(gaussians.opacities, expected, atol=1e-6)
    whole = {"opacity_decay": 0.9, "pace_steps": 0}
    even, spared = (trainer(options=whole | {"opacity_spare": s}) for s in (0.0, 5.0))
    assert spared.run().gaussians.opacities.mean() > even.run().gaussians.opacities.mean()


def test_nobody_dropped_what_an_earlier_capacity_made() -> None:
    stats = StepStats(torch.ones(2, 2), torch.ones(2), 8, 8, factors=torch.tensor([0.0, 0.5]))
    followed = _moved(stats, torch.tensor([1, 0, -1, -1]))
    assert followed.factors is not None and followed.factors.tolist() == [0.5, 0.0, 1.0, 1.0]
    assert followed.radii.tolist() == [1, 1, 0, 0]


def test_a_second_field_of_its_own_draw(caplog: pytest.LogCaptureFixture) -> None:
    """With a capacity that draws nothing both are one field, unless the second begins elsewhere."""
    quiet = registry.build("reg", {"name": "co_register", "weight": 0.0})
    other = textured_plane(0)[2]
    with caplog.at_level("WARNING"):
        trainer(reg=quiet, second=other)
    assert "this init draws nothing" in caplog.text
    for second in (None, other.replace(sh0=other.sh0 + 0.1)):
        both = trainer(reg=quiet, second=second)
        both.run()
        assert both.second is not None
        same = torch.equal(both.field.params.sh0, both.second.params.sh0)
        assert same is (second is None)
    for drawn in (False, True):
        reg = registry.build("reg", {"name": "co_register", "second_drawn": drawn})
        assert plugins(reg=reg).second_drawn is drawn
