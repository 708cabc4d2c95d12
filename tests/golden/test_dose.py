"""Pseudo views as training examples of their own, and how much of a method a training got."""

import itertools
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from framework import registry
from framework.kernels.losses import photometric_gradient
from framework.options import TrainerOptions
from framework.plugin import Augmenter, Regularizer, StepContext, SubStep
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.registry import ActivePlugin
from framework.run.members import in_turn
from framework.run.plane import textured_plane
from framework.train.dose import NEVER, joined, summary
from framework.train.epoch import Item, Items
from framework.train.optim import Adam
from framework.train.trainer import Plugins, Trained, Trainer
from framework.types import PSEUDO, Camera, View
from tests.built import plugins

STEPS, K = 12, 3  # four epochs


@dataclass(frozen=True)
class Darker(Augmenter):
    """One pseudo view in every epoch that `every` divides; logs for each of its tries why it made
    none."""

    every: int = 1
    silent: int = -1  # epoch without a view and without a word

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
        if ctx.epoch == self.silent:
            return [], state
        ctx.log("Darker_refused_mood", 1.0)  # the first try
        if ctx.epoch % self.every:
            ctx.log("Darker_refused_mood", 1.0)
            return [], state
        ctx.log("Darker_light", 0.5 + ctx.epoch)
        return [replace(ctx.views[0], name="dark", image=ctx.views[0].image * 0.5)], state


class Noting(Trainer):
    """Notes the names of the views of every update."""

    names: list[list[str]]

    def _update(self, items: list[Item], turn: int = 0) -> Any:
        self.names.append([item.view.name for item in items])
        return super()._update(items, turn)


def darker(every: int = 1, weight: float = 1.0) -> dict[str, ActivePlugin]:
    return {"augment": ActivePlugin(Darker(every), weight, 0.0, 1.0)}


def train(chosen: Plugins, **options: Any) -> tuple[Trained, list[list[str]]]:
    settings = TrainerOptions(**{"steps": STEPS, "evaluations": 1, "coarse_factor": 1, **options})
    trainer = Noting(*textured_plane(settings.sh_degree), settings, chosen, 0, Silent())
    trainer.names = []
    return trainer.run(), trainer.names


def test_an_epoch_has_k_real_updates_and_the_pseudo_view_s_own_before_one_of_them() -> None:
    _, plain = train(plugins())
    _, together = train(plugins(**darker()))
    trained, ours = train(plugins(**darker()), pseudo_steps="own")
    assert len(plain) == len(together) == STEPS and len(ours) == STEPS + STEPS // K
    assert all(len(update) == 1 for update in ours)
    # the same real view at every step, and the pseudo views at the same steps
    assert [update for update in ours if update != ["dark"]] == plain
    joins = [update[0] for update in together if update[1:]]
    assert [after[0] for update, after in itertools.pairwise(ours) if update == ["dark"]] == joins
    assert ours[-1] != ["dark"]
    assert trained.history[-1].step == STEPS
    assert trained.dose["steps"][0] == STEPS + STEPS // K
    assert trained.dose["loss.real"][0] == STEPS and trained.dose["loss.pseudo"][0] == STEPS // K


def test_own_updates_differ_from_joined_ones_and_neither_from_itself() -> None:
    bits = [
        parameters_sha256(train(plugins(**darker()), pseudo_steps=how)[0].gaussians)
        for how in ("own", "own", "joined")
    ]
    assert bits[0] == bits[1] != bits[2]
    plain = [train(plugins(), pseudo_steps=how, pseudo_mean=mean)[0].gaussians
             for how, mean in (("joined", "frame"), ("own", "covered"))]  # fmt: skip
    assert parameters_sha256(plain[0]) == parameters_sha256(plain[1])


def test_opacities_fade_in_real_updates_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    decays: list[float] = []
    step_from = Adam.step_from

    def noted(self: Adam, actual: Any, rates: Any, decay: float = 1.0) -> Any:
        decays.append(decay)
        return step_from(self, actual, rates, decay)

    monkeypatch.setattr(Adam, "step_from", noted)
    options = {"opacity_decay": 0.9, "pace_steps": 0, "binocular": 0.0}
    _, names = train(plugins(**darker()), pseudo_steps="own", **options)
    assert decays == [1.0 if update == ["dark"] else 0.9 for update in names]


@pytest.mark.parametrize("how", ["joined", "own"])
def test_the_second_camera_is_beside_photos_of_the_last_third_alone(
    monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    watched: list[list[bool]] = []
    update = Trainer._update

    def noted(self: Trainer, items: list[Item], turn: int = 0) -> Any:
        watched.append([item.beside is not None for item in items])
        return update(self, items, turn)

    monkeypatch.setattr(Trainer, "_update", noted)
    own_pace = {"pseudo_steps": how, "pace_steps": 0}
    trained, names = train(plugins(**darker()), **own_pace)
    steps = [pair for pair in zip(names, watched, strict=True) if pair[0] != ["dark"]]
    assert [shifted[0] for _, shifted in steps] == [False] * 9 + [True] * 3  # from 8.004 on
    dark = [pair for pair in zip(names, watched, strict=True) if "dark" in pair[0]]
    assert dark and not any(shifted[update.index("dark")] for update, shifted in dark)
    plain, _ = train(plugins(**darker()), **own_pace, binocular=0.0)
    assert parameters_sha256(plain.gaussians) != parameters_sha256(trained.gaussians)
    # the reported loss is that of the photos alone, until the term has moved something
    assert plain.dose["loss.real"][0] == trained.dose["loss.real"][0]


def test_every_update_has_draws_of_its_own_and_the_real_ones_are_the_plain_trainer_s() -> None:
    @dataclass(frozen=True)
    class Drawing(Regularizer):
        def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
            state = [*(state or []), float(ctx.rng("own").random())]
            drawn.append(state[-1])
            return None, state

    drawn: list[float] = []
    reg = {"reg": ActivePlugin(Drawing())}
    _, _ = train(plugins(**reg))
    plain = list(drawn)
    drawn.clear()
    _, names = train(plugins(**reg, **darker()), pseudo_steps="own")
    assert len(set(drawn)) == len(drawn) == STEPS + STEPS // K
    assert [d for d, update in zip(drawn, names, strict=True) if update != ["dark"]] == plain


def test_the_loss_over_the_covered_pixels() -> None:
    """Whatever the mask covers, and at the resolution that is trained."""
    image = torch.rand(3, 32, 32, generator=torch.Generator().manual_seed(0))
    mask = torch.zeros(32, 32)
    mask[:20, :12] = 1.0
    view = View("v", Camera(torch.eye(4), torch.eye(3), 32, 32), image * mask, mask, 0.5)
    pseudo, black = replace(view, tags=(PSEUDO,)), torch.zeros(3, 32, 32).numpy()
    for factor in (1, 2):
        item = Items(covered=True).get(pseudo, factor)
        size = 32 // factor
        loss, _ = photometric_gradient(
            black[:, :size, :size].copy(), item.target, 0.0, item.view.weight
        )
        inside = item.view.mask
        assert inside is not None
        assert loss == pytest.approx(0.5 * float(item.view.image[:, inside > 0].mean()), rel=1e-5)
    assert Items(covered=True).get(view, 1).view.weight == 0.5  # a photo's stays
    assert Items().get(pseudo, 1).view.weight == 0.5
    assert Items(covered=True).get(replace(pseudo, mask=None), 1).view.weight == 0.5
    nothing = replace(pseudo, mask=0 * mask)
    assert Items(covered=True).get(nothing, 1).view.weight == 0.5


def test_what_is_told_by_hand() -> None:
    assert summary({"steps": (10, 0.0), "loss.real": (10, 5.0)}) == {}
    tallies = {
        **{"steps": (12, 0.0), "loss.real": (12, 3.0), "loss.pseudo": (2, 1.0)},
        **{"augment.asked": (6, 2.0), "augment.views": (2, 0.0)},
        **{"log.augment.coverage": (4, 2.0), "log.augment.refused_coverage": (3, 3.0)},
        **{"reg.asked": (8, 0.0), "reg.acted": (6, 0.0), "reg.dropped": (8, 1.2)},
        **{"log.reg.ranked": (2, 60.0), "log.capacity.noise": (1, 1.0)},
    }
    assert summary(tallies) == {
        **{"views_asked": 6, "views_made": 2, "refused_coverage": 3, "refused_other": 1},
        **{"coverage_mean": 0.5, "ranked_mean": 30.0},
        **{"pseudo_share_of_loss": 0.25, "pseudo_share_of_views": pytest.approx(1 / 7)},
        **{"share_dropped_mean": pytest.approx(0.1), "reg_acted_share": 0.75},
        **{"augment_acted_share": pytest.approx(1 / 3), "acted_share": pytest.approx(1 / 3)},
    }
    unasked = summary({"steps": (1, 0.0), "augment.asked": (0, 0.0), "augment.views": (0, 0.0)})
    assert unasked["views_asked"] == 0 and unasked["acted_share"] == NEVER
    assert (
        summary({"augment.asked": (1, 1.0), "log.augment.x": (1, float("nan"))})["x_mean"]
        == "not finite"
    )


def test_members_are_told_together() -> None:
    one, _ = train(plugins(**darker()))
    two = in_turn([[one], [one]], one.gaussians).dose
    assert two == joined([one.dose, one.dose]) and two["steps"] == (2 * STEPS, 0.0)
    assert summary(two)["pseudo_share_of_loss"] == pytest.approx(
        summary(one.dose)["pseudo_share_of_loss"]
    )


def test_the_dose_of_a_training() -> None:
    uniform = registry.build("reg", {"name": "uniform", "p": 0.5, "schedule": "constant",
                                     "count": "exact", "start": 0.25, "stop": 0.75})  # fmt: skip
    trained, _ = train(plugins(**darker(every=2, weight=0.0), reg=uniform))
    actual = summary(trained.dose)
    assert (actual["views_asked"], actual["views_made"]) == (4, 2)
    assert (actual["refused_mood"], actual["refused_coverage"], actual["refused_other"]) == (
        2,
        0,
        0,
    )
    quiet, _ = train(plugins(augment=ActivePlugin(Darker(every=2, silent=3))))
    assert [summary(quiet.dose)[f"refused_{why}"] for why in ("mood", "other")] == [1, 1]
    assert actual["light_mean"] == 1.5 and actual["pseudo_share_of_loss"] == 0
    assert actual["reg_acted_share"] == 1.0 and actual["acted_share"] == 0.5
    assert actual["share_dropped_mean"] == pytest.approx(0.25)  # half of them in half of the steps
    assert summary(train(plugins())[0].dose) == {}
    term = registry.build("reg", {"name": "patch_smoothness", "weight": 1e4})
    shares = [summary(train(plugins(**darker(), **reg))[0].dose) for reg in ({}, {"reg": term})]
    photometric = [float(share["pseudo_share_of_loss"]) for share in shares]  # type: ignore[arg-type]
    assert photometric[1] == pytest.approx(photometric[0], rel=0.2)  # without what the term adds
    more = [summary(train(plugins(**darker(weight=w)))[0].dose) for w in (0.3, 1.0)]
    assert 0 < more[0]["pseudo_share_of_loss"] < more[1]["pseudo_share_of_loss"] < 0.5  # type: ignore[operator]


def test_a_method_that_acts_on_less_than_half_is_told(caplog: pytest.LogCaptureFixture) -> None:
    class Rare(Regularizer):
        def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
            few = ctx.step < 5
            return torch.full((len(ctx.gaussians),), 0.5 if few else 1.0), state

    with caplog.at_level(logging.WARNING, "framework"):
        train(plugins(**darker(every=2)))
        assert not caplog.records
        train(plugins(**darker(every=3), reg=ActivePlugin(Rare())), steps=15)
    messages = [record.getMessage() for record in caplog.records]
    assert messages == [
        "augment=Darker: acted in only 2 of 5 epochs between augment.start=0 and augment.stop=1; in"
        " 0 the coverage was below augment.min_coverage",
        "reg=Rare: acted in only 5 of 15 training steps between reg.start=0 and reg.stop=1",
    ]


def test_steps_of_its_own_and_a_loss_are_one_act(caplog: pytest.LogCaptureFixture) -> None:
    class Both(Regularizer):
        def loss(self, ctx: Any, state: Any, view: Any, render: Any) -> Tensor:
            total: Tensor = ctx.gaussians.opacities.mean()
            return total

        def substeps(self, ctx: Any, state: Any, view: Any) -> Iterator[SubStep]:
            yield ctx.gaussians.opacities.mean(), ("opacity_logits",)

    with caplog.at_level(logging.WARNING, "framework"):
        trained, _ = train(plugins(**darker(), reg=ActivePlugin(Both())), steps=15)
    assert not caplog.records
    assert trained.dose["reg.asked"][0] == trained.dose["reg.acted"][0] == 15
    assert trained.dose["substeps"][0] == 15


def test_a_loss_term_is_an_act_however_many_views_a_step_has() -> None:
    class Faint(Regularizer):
        def loss(self, ctx: Any, state: Any, view: Any, render: Any) -> Tensor:
            total: Tensor = ctx.gaussians.opacities.mean()
            return total

    idle = summary(train(plugins(**darker(every=99), reg=ActivePlugin(Regularizer())))[0].dose)
    assert idle["reg_acted_share"] == 0 and idle["views_made"] == 1
    trained, _ = train(plugins(**darker(), reg=ActivePlugin(Faint())))
    actual = summary(trained.dose)
    assert actual["reg_acted_share"] == 1.0 and "share_dropped_mean" not in actual
