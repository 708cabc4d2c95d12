"""The trainer on three tiny views of a plane: what may change its result and what may not."""

import logging
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from framework import registry
from framework.errors import UserError
from framework.kernels import ScreenGradient
from framework.options import TrainerOptions
from framework.plugin import Augmenter, Capacity, Edits, Regularizer, StepContext, StepStats
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.registry import ActivePlugin
from framework.run.plane import textured_plane
from framework.train import schedule
from framework.train.epoch import Items, box_mean
from framework.train.optim import Adam
from framework.train.trainer import Plugins, Trained, Trainer
from framework.types import PSEUDO, Camera, Gaussians, View
from plugins.capacity.fixed import Fixed
from tests.built import plugins


def _trainer(chosen: Plugins | None = None, evaluate: Any = None, **options: Any) -> Trainer:
    settings = TrainerOptions(**{"steps": 12, "evaluations": 1, "sh_every": 4, **options})
    training, depth, gaussians = textured_plane(settings.sh_degree)
    return Trainer(training, depth, gaussians, settings, chosen or plugins(), 0, Silent(), evaluate)


def _train(chosen: Plugins | None = None, evaluate: Any = None, **options: Any) -> Trained:
    return _trainer(chosen, evaluate, **options).run()


def test_training_lowers_the_loss() -> None:
    losses = [row.loss for row in _train(steps=60, coarse_factor=1, opacity_decay=1.0).history]
    assert sum(losses[-6:]) < 0.95 * sum(losses[:6])  # white noise: there is little to gain


def test_evaluation_touches_nothing() -> None:
    """However often and rudely the test views are looked at, the result has the same bits."""

    def rude(gaussians: Gaussians, background: Tensor, sh_degree: int) -> float:
        gaussians.means.fill_(float("nan"))
        return 1.0

    quiet = _train(evaluate=None, evaluations=1)
    watched = _train(evaluate=rude, evaluations=6)
    assert parameters_sha256(quiet.gaussians) == parameters_sha256(watched.gaussians)


@pytest.mark.parametrize("background", ["mean", "black", "white", "random"])
def test_backgrounds_train_and_differ(background: str) -> None:
    trained = _train(background=background)
    assert all(torch.isfinite(tensor).all() for _, tensor in trained.gaussians.items())
    assert trained.background.shape == (3,)
    expected = {"black": 0.0, "white": 1.0}
    if background in expected:
        assert torch.equal(trained.background, torch.full((3,), expected[background]))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_harmonics_join_one_degree_at_a_time(degree: int) -> None:
    trained = _train(sh_degree=degree)
    active = [row.sh_degree for row in trained.history]
    assert active[-1] == min(degree, 12 // 4)
    assert active == sorted(active)
    if degree == 3:
        used = trained.gaussians.shN.abs().amax((0, 2)) > 0
        assert used.tolist() == [True] * 8 + [False] * 7  # degree 3 joins after the last step


def test_a_capacity_that_removes_all_is_an_error() -> None:
    @dataclass(frozen=True)
    class Nothing(Capacity):
        def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits, Any]:
            return Edits(keep=torch.zeros(len(ctx.gaussians), dtype=torch.bool)), state

    with pytest.raises(UserError, match="removed every Gaussian"):
        _train(plugins(capacity=ActivePlugin(Nothing())))


def test_a_loss_that_is_not_finite_is_an_error() -> None:
    @dataclass(frozen=True)
    class Broken(Regularizer):
        def loss(self, ctx: StepContext, state: Any, view: View, render: Any) -> Tensor:
            return render.rgb.sum() * float("nan")

    with pytest.raises(UserError, match="reg=Broken: loss: expected a finite number, got nan"):
        _train(plugins(reg=ActivePlugin(Broken())))


def test_a_loss_may_be_of_the_gaussians_themselves() -> None:
    class Faint(Regularizer):
        def loss(self, ctx: Any, state: Any, view: Any, render: Any) -> Tensor:
            total: Tensor = ctx.gaussians.opacities.mean()
            return total

    plain, faint = (
        _train(plugins(**chosen), steps=30)
        for chosen in ({}, {"reg": ActivePlugin(Faint(), 10.0, 0.0, 1.0)})
    )
    assert faint.gaussians.opacities.mean() < 0.8 * plain.gaussians.opacities.mean()


@pytest.mark.parametrize(("coverage", "text"), [(1.0, True), (0.0, False)])
def test_an_augmenter_that_gave_nothing_is_told(
    coverage: float, text: bool, caplog: pytest.LogCaptureFixture
) -> None:
    built = registry.build("augment", {"name": "dba", "min_coverage": coverage, "stop": 1.0})
    with caplog.at_level(logging.WARNING, "framework"):
        _train(plugins(augment=built))
        _train(plugins())
    messages = [record.getMessage() for record in caplog.records]
    assert len(messages) == text
    assert all("augment=dba: acted in only 0 of" in message for message in messages)


def test_bands_that_were_never_active_are_told(caplog: pytest.LogCaptureFixture) -> None:
    """`preset=paper trainer.steps=300` would store three degrees of zeros without a word."""
    with caplog.at_level(logging.WARNING, "framework"):
        _train(sh_degree=3, sh_every=0)
        _train(sh_degree=2, sh_every=4)
        _train(sh_degree=2, sh_every=100)
    (message,) = (record.getMessage() for record in caplog.records)
    assert message.startswith("trainer.sh_degree=2: only degree 0 was active")


def test_a_capacity_that_never_acted_is_told(caplog: pytest.LogCaptureFixture) -> None:
    """ADC of the literature begins after 500 steps; that the number is fixed needs no telling."""
    with caplog.at_level(logging.WARNING, "framework"):
        _train(plugins(capacity=registry.build("capacity", {"name": "adc"})))
        _train(plugins())
        often = registry.build("capacity", {"name": "adc", "every": 2, "from_step": 0})
        _train(plugins(capacity=often))
    (message,) = (record.getMessage() for record in caplog.records)
    assert message.startswith("capacity=adc: changed no Gaussian in")


def test_an_inactive_method_changes_nothing() -> None:
    """`start=1` keeps a plugin out: the bits are those without it."""
    plain = _train()
    for group, name in (("augment", "safi"), ("reg", "uar")):
        built = registry.build(group, {"name": name, "start": 1.0, "stop": 1.0})
        trained = _train(plugins(**{group: built}))
        assert parameters_sha256(trained.gaussians) == parameters_sha256(plain.gaussians)


def test_pseudo_views_are_never_kept() -> None:
    """An augmenter may return a changed real view under its old name: it must be trained on."""

    @dataclass(frozen=True)
    class Brighter(Augmenter):
        name = "brighter"
        by: float

        def init_state(self, ctx: StepContext) -> None:
            return None

        def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
            view = ctx.views[0]
            return [replace(view, image=view.image * self.by**ctx.epoch)], state

    bits = {
        parameters_sha256(_train(plugins(augment=ActivePlugin(Brighter(by)))).gaussians)
        for by in (1.0, 0.5)
    }
    assert len(bits) == 2


def test_a_pseudo_view_adds_its_weighted_gradient_to_its_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """And has no say in what the capacity plugin sees."""

    @dataclass(frozen=True)
    class Darker(Augmenter):
        def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
            # each joins a random step: with so many the first gets some
            return [replace(view, image=view.image * 0.5) for view in 3 * ctx.views], state

    step, update = Adam.step, Fixed.update
    gradients: list[dict[str, Tensor]] = []
    pulls: list[Tensor] = []

    def noted(self: Adam, params: Gaussians, grads: Any, *others: Any) -> tuple[str, ...]:
        gradients.append({name: gradient.clone() for name, gradient in grads.items()})
        return step(self, params, grads, *others)

    def whole_first(self: Adam, actual: ScreenGradient, *others: Any) -> tuple[Any, Tensor]:
        tensors, means2d = actual.pull_back()
        return noted(self, actual.gaussians, tensors, *others), means2d

    def watched(self: Any, ctx: StepContext, state: Any, stats: StepStats) -> Any:
        pulls.append(stats.means2d_grad.clone())
        return update(self, ctx, state, stats)

    monkeypatch.setattr(Adam, "step", noted)
    monkeypatch.setattr(Adam, "step_from", whole_first)
    monkeypatch.setattr(Fixed, "update", watched)
    for weight in (None, 0.5, 1.0):
        chosen = plugins(augment=ActivePlugin(Darker(), weight)) if weight else plugins()
        _train(chosen, steps=1, coarse_factor=1)
    plain, half, whole = gradients
    for name in plain:
        middle = (plain[name] + whole[name]) / 2
        torch.testing.assert_close(half[name], middle, rtol=1e-3, atol=1e-8)
    for name in ("means", "log_scales", "opacity_logits", "sh0"):
        assert not torch.allclose(half[name], plain[name], rtol=0.01, atol=1e-8), name
    assert torch.equal(pulls[0], pulls[1]) and torch.equal(pulls[0], pulls[2])


def test_a_weight_that_would_do_nothing_is_refused() -> None:
    for group, name in (("reg", "uar"), ("capacity", "fixed"), ("augment", "none")):
        with pytest.raises(UserError, match=rf"{group}={name}: weight multiplies a loss"):
            registry.build(group, {"name": name, "weight": 0.5})
    assert registry.build("augment", {"name": "safi", "weight": 0.5}).weight == 0.5


def test_harmonics_join_by_half_of_the_training() -> None:
    options = TrainerOptions(steps=600, sh_degree=3)
    active = [schedule.sh_degree(options, step, 3) for step in (0, 99, 100, 200, 300, 599)]
    assert active == [0, 0, 1, 2, 3, 3]


def test_schedule_of_the_rates() -> None:
    options = TrainerOptions(steps=100, evaluations=4)
    first, half, last = (schedule.learning_rates(options, s, extent=2.0) for s in (0, 50, 100))
    assert first["means"] == pytest.approx(options.lr_scale * options.lr_means * 2)
    assert last["means"] == pytest.approx(first["means"] * options.lr_means_final)
    assert half["sh0"] == pytest.approx(first["sh0"])
    assert last["sh0"] == pytest.approx(first["sh0"] * options.lr_final)
    assert schedule.evaluation_steps(options) == {25, 50, 75, 100}
    assert schedule.evaluation_steps(TrainerOptions(steps=2)) == {1, 2}


def test_coarse_images_become_finer_by_octaves() -> None:
    options = TrainerOptions(steps=100, coarse_factor=8, coarse_until=0.9, coarse_octaves=True)
    factors = [schedule.coarse_factor(options, step) for step in range(100)]
    assert factors == [8] * 30 + [4] * 30 + [2] * 30 + [1] * 10
    at_once = replace(options, coarse_octaves=False)
    assert [schedule.coarse_factor(at_once, step) for step in (0, 89, 90)] == [8, 8, 1]
    alone = replace(options, coarse_factor=1)
    assert schedule.coarse_factor(alone, 0) == 1


def test_pseudo_views_are_small_from_first_to_last() -> None:
    camera = Camera(torch.eye(4), torch.eye(3), 64, 40)
    photo = View("photo", camera, torch.zeros(3, 40, 64))
    pseudo = replace(photo, tags=(PSEUDO,))
    options = TrainerOptions(steps=100, coarse_factor=2, coarse_until=0.5, pseudo_factor=4)

    def factors(view: View, **changes: int) -> list[int]:
        chosen = replace(options, **changes)
        return [schedule.downsampling(chosen, step, view) for step in (0, 49, 50, 99)]

    assert factors(photo) == [2, 2, 1, 1]
    assert factors(pseudo) == [2, 2, 2, 2]  # 40 / 4 pixels are too few
    assert factors(pseudo, pseudo_factor=1) == factors(photo)
    assert factors(pseudo, coarse_factor=1) == [2, 2, 2, 2]


def test_a_small_pseudo_view_has_the_mean_of_what_was_warped() -> None:
    """A photo's coarse pixel is valid where all of its pixels are."""
    image, mask = torch.full((3, 16, 16), 0.6), torch.ones(16, 16)
    mask[0, 0] = mask[0, 2] = mask[1, 2] = mask[0, 4] = mask[1, 4] = mask[1, 5] = 0
    camera = Camera(torch.eye(4), torch.eye(3), 16, 16)
    photo = View("photo", camera, image * mask, mask)
    seen = Items().get(photo, 2).view.mask
    warped = Items().get(replace(photo, tags=(PSEUDO,)), 2).view
    assert seen is not None and warped.mask is not None
    assert seen[0, :4].tolist() == [0, 0, 0, 1] and seen[1:].all()
    assert warped.mask[0, :4].tolist() == [1, 1, 0, 1] and warped.mask[1:].all()
    torch.testing.assert_close(warped.image, 0.6 * warped.mask.expand(3, 8, 8))


def test_a_view_is_made_ready_once_while_it_is_the_same() -> None:
    """A pseudo view that lives for two epochs comes with new weights and tags in each."""
    image, camera = torch.full((3, 16, 16), 0.6), Camera(torch.eye(4), torch.eye(3), 16, 16)
    items, pseudo = Items(), View("pseudo-1", camera, image, torch.ones(16, 16), tags=(PSEUDO,))
    first = items.get(pseudo, 2)
    items.begin([pseudo])
    assert items.get(replace(pseudo, tags=(PSEUDO,)), 2) is first
    assert items.get(replace(pseudo, tags=("own", PSEUDO)), 2).view.tags == ("own", PSEUDO)
    assert items.get(pseudo, 1) is not first
    heavier = items.get(replace(pseudo, weight=2.0), 2)
    assert heavier is not first and heavier.view.weight == 2
    image.mul_(0.5)  # its plugin may change what is its own
    torch.testing.assert_close(items.get(pseudo, 2).view.image, torch.full((3, 8, 8), 0.3))
    with torch.inference_mode():  # as from a network: their writes are not counted
        built = View("pseudo-1", camera, 0.5 * image, torch.ones(16, 16), tags=(PSEUDO,))
    assert items.get(built, 2) is not items.get(built, 2)
    items.begin([replace(pseudo, name="pseudo-3")])
    assert not items._kept


def test_a_training_forgets_the_pseudo_views_of_earlier_epochs() -> None:
    @dataclass(frozen=True)
    class Fresh(Augmenter):
        def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
            return [replace(ctx.views[0], name=f"pseudo-{ctx.epoch}")], state

    trainer = _trainer(plugins(augment=ActivePlugin(Fresh())))
    trainer.run()
    assert trainer.epoch > 2
    kept = {name for pseudo, name in trainer.items._kept if pseudo}
    assert kept == {view.name for view in trainer.pseudo} and len(kept) == 1


def test_coarse_views_keep_the_field_of_view() -> None:
    camera = Camera(torch.eye(4), torch.tensor([[60.0, 0, 33], [0, 50, 20], [0, 0, 1]]), 65, 48)
    image = torch.rand(3, 48, 65, generator=torch.Generator().manual_seed(0))
    mask = torch.ones(48, 65)
    mask[0, 0] = 0
    item = Items().get(View("v", camera, image, mask), 2)
    assert (item.view.camera.width, item.view.camera.height) == (32, 24)
    assert float(item.view.camera.K[0, 0]) == 30
    assert item.view.mask is not None and float(item.view.mask[0, 0]) == 0
    assert float(item.view.mask.sum()) == 32 * 24 - 1
    expected = image[:, 2:4, 4:6].mean((1, 2))
    torch.testing.assert_close(box_mean(image, 2)[:, 1, 2], expected)
