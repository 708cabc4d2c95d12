"""What every discovered plugin must keep to in a training, and that others' draws stay its own.

Twenty steps on three tiny views of a plane, long enough for the methods whose schedule in steps is
shortened by `EAGER`; a plugin without an entry there trains with its defaults.
"""

import dataclasses
import functools
import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from framework import registry
from framework.options import TrainerOptions
from framework.plugin import (
    Augmenter,
    Capacity,
    Edits,
    GradientAt,
    Regularizer,
    StepContext,
    StepStats,
)
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.run.members import IDLE
from framework.run.plane import textured_plane
from framework.train.trainer import Plugins, Trained, Trainer
from framework.types import View

ALL = [(group, name) for group in registry.GROUPS for name in sorted(registry.table(group))]
NEUTRAL = {"augment": "none", "reg": "none", "capacity": "fixed"}
ACTING = {"augment": "safi", "reg": "uar", "capacity": "adc"}
SEEN_ELSEWHERE = (  # a second field is the first one's twin here
    "co_prune",  # identical twins are never far apart
    "self_ensemble",  # moves the second alone
)
EAGER: dict[str, dict[str, Any]] = {
    "adc": {"from_step": 4, "every": 4, "grad_threshold": 1e-6},
    "occlusion": {"depth": 4.0},
    "safi": {"refresh_epochs": 2},
    "sh_dropout": {"each": 1.0},
    "uar": {"refresh": 4, "schedule": "constant"},
}


def content_sha256(value: Any) -> str:
    """SHA-256 hex of all that a value of `framework.types` holds, tensors by their bytes."""
    digest = hashlib.sha256()

    def add(part: Any) -> None:
        digest.update(type(part).__name__.encode())
        if isinstance(part, Tensor):
            digest.update(f"{part.dtype} {tuple(part.shape)}".encode())
            digest.update(part.detach().contiguous().numpy().tobytes())
        elif isinstance(part, tuple):
            for item in part:
                add(item)
        elif dataclasses.is_dataclass(part):
            add(tuple(getattr(part, field.name) for field in dataclasses.fields(part)))
        else:
            digest.update(repr(part).encode())

    add(value)
    return digest.hexdigest()


@functools.cache
def train(**names: str) -> tuple[Trained, bool]:
    """A training with the named plugins, all active throughout, and whether its input is intact."""
    chosen = {**NEUTRAL, **names}

    def options_of(name: str) -> dict[str, Any]:
        if "+" in name:
            return {"name": name, **{part: options_of(part) for part in name.split("+")}}
        return {"name": name, **EAGER.get(name, {}), "start": 0.0, "stop": 1.0}

    plugins = Plugins.of({group: options_of(name) for group, name in chosen.items()})
    training, depth, gaussians = textured_plane(1)
    tilt = torch.linspace(0.99, 1.01, depth[0].depth.shape[1])  # of a flat one nothing correlates
    depth = tuple(dataclasses.replace(each, depth=each.depth * tilt) for each in depth)
    inputs = training, depth, gaussians
    before = content_sha256(inputs)
    options = TrainerOptions(steps=20, sh_degree=1, sh_every=8, evaluations=1)
    trained = Trainer(*inputs, options, plugins, 0, Silent()).run()
    return trained, content_sha256(inputs) == before


def bits(**names: str) -> str:
    return parameters_sha256(train(**names)[0].gaussians)


@pytest.mark.parametrize(("group", "name"), ALL)
def test_the_result_is_finite_and_the_input_untouched(group: str, name: str) -> None:
    trained, intact = train(**{group: name})
    assert intact
    assert len(trained.gaussians) > 0
    assert all(torch.isfinite(tensor).all() for _, tensor in trained.gaussians.items())
    assert all(math.isfinite(row.loss) for row in trained.history)
    assert all(math.isfinite(value) for row in trained.history for value in row.logged.values())


@pytest.mark.parametrize(("group", "name"), ALL)
def test_the_same_training_has_the_same_bits(group: str, name: str) -> None:
    again, _ = train.__wrapped__(**{group: name})
    assert parameters_sha256(again.gaussians) == bits(**{group: name})


@pytest.mark.parametrize(("group", "name"), ALL)
def test_these_trainings_are_long_enough_to_act(group: str, name: str) -> None:
    """Otherwise the tests here would pass without testing anything. A plugin that fails here
    needs options in `EAGER` that make it act within 20 steps of SH degree 1."""
    plugin = registry.lookup(group, name)
    if not getattr(plugin, "idle", False) and name not in SEEN_ELSEWHERE:
        assert bits(**{group: name}) != bits()


def draw(ctx: StepContext) -> None:
    """Draw a lot, also for purposes that others have."""
    for purpose in ("own", "camera", "uar", "split"):
        ctx.rng(purpose).random(1000)


@dataclass(frozen=True)
class DrawingAugmenter(Augmenter):
    """Draws, and returns no views."""

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
        draw(ctx)
        return [], state


@dataclass(frozen=True)
class DrawingRegularizer(Regularizer):
    """Draws, and changes nothing."""

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        draw(ctx)
        return None, state


@dataclass(frozen=True)
class DrawingCapacity(Capacity):
    """Draws, and edits nothing."""

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        draw(ctx)
        return None, state


DRAWING = {"augment": DrawingAugmenter, "reg": DrawingRegularizer, "capacity": DrawingCapacity}


@pytest.fixture
def drawing(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """One more plugin, `drawing`, in each group; gone afterwards."""
    with monkeypatch.context() as patch:
        for group in registry.GROUPS:
            patch.setitem(registry._classes, group, dict(registry._classes[group]))
            registry.register(group, "drawing")(DRAWING[group])
        yield


@pytest.mark.parametrize("group", list(registry.GROUPS))
@pytest.mark.parametrize("others", [NEUTRAL, ACTING], ids=["neutral", "acting"])
def test_one_more_plugin_moves_no_other_draw(
    drawing: None, group: str, others: dict[str, str]
) -> None:
    plain = bits(**{**others, group: NEUTRAL[group]})
    assert bits(**{**others, group: "drawing"}) == plain


class Home(Regularizer):
    """Pulls the means to the origin, whatever the photos say."""

    sign: ClassVar[float] = 1.0

    def gradient(
        self, ctx: StepContext, state: Any, actual: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor]:
        return {**actual, "means": self.sign * ctx.gaussians.means.detach()}


class Away(Home):
    """Pushes them away from it."""

    sign: ClassVar[float] = -1.0


class Mirrored(Regularizer):
    """The means' gradient as it is where they are mirrored at the origin."""

    def gradient(
        self, ctx: StepContext, state: Any, actual: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor]:
        mirrored = ctx.gaussians.replace(means=-ctx.gaussians.means.detach())
        return {**actual, "means": at(mirrored)["means"]}


def test_a_gradient_elsewhere_holds_what_the_regularizers_before_made_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(registry._classes, "reg", dict(registry._classes["reg"]))
    for each in (Home, Away, Mirrored):
        registry.register("reg", each.__name__.lower())(dataclass(frozen=True)(each))
    away = bits(reg="away")
    assert bits(reg="home+mirrored") == away
    assert away not in (bits(reg="home"), bits(reg="mirrored"))


def test_a_regularizer_that_ended_has_no_word_in_what_is_evaluated() -> None:
    """`reg=removal` thins opacities for the tests, where its dropout went on to the last step."""
    thinned = {}
    for stop in (0.5, 1.0):
        reg = registry.build("reg", {"name": "removal", "start": 0.0, "stop": stop, "p": 0.5})
        plugins = Plugins({**Plugins.of(IDLE).each, "reg": reg})
        trainer = Trainer(
            *textured_plane(1), TrainerOptions(steps=4, evaluations=1), plugins, 0, Silent()
        )
        kept = trainer.run().gaussians.opacities.mean()
        thinned[stop] = float(kept / trainer.field.params.detach().opacities.mean())
    assert thinned[0.5] == 1.0 and thinned[1.0] == pytest.approx(0.5, abs=1e-3)
