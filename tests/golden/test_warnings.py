"""Warnings about choices without effect, and limits that always hold."""

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from framework import registry
from framework.errors import UserError
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.run.members import IDLE
from framework.run.plane import textured_plane
from framework.toolbox.elsewhere import known_depth
from framework.train import schedule
from framework.train.adam_kernels import LOWEST_LOGIT
from framework.train.descent import Fading, fade
from framework.train.resume import checkpoint
from framework.train.resume.training_state import Plugins
from framework.train.trainer import Trainer
from framework.warp.zbuffer import prepare, warp
from tests.plugins.fakes import context
from tests.warp.stage import camera, exact, photograph


def trained(steps: int = 12, **chosen: Mapping[str, Any]) -> Trainer:
    options = TrainerOptions(steps=steps, evaluations=1, coarse_factor=1)
    trainer = Trainer(*textured_plane(0), options, Plugins.of({**IDLE, **chosen}), 0, Silent())
    trainer.run()
    return trainer


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        ({"augment": {"name": "dba", "start": 0.3, "stop": 0.4}}, "augment=dba: was never called"),
        ({"reg": {"name": "uar", "start": 0.5, "stop": 0.5}}, "reg=uar: was never called"),
        (
            {"capacity": {"name": "self_ensemble"}},
            "capacity=self_ensemble: changes only",
        ),
        ({"capacity": {"name": "self_ensemble"}, "reg": {"name": "co_register"}}, ""),
        ({}, ""),
    ],
)
def test_what_was_never_asked_is_told(
    chosen: dict[str, Any], message: str, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, "framework"):
        trained(**chosen)
    said = [r.getMessage() for r in caplog.records if "was never called" in r.getMessage()]
    said += [r.getMessage() for r in caplog.records if "second field" in r.getMessage()]
    assert [line[: len(message)] for line in said] == ([message] if message else [])


def test_options_that_change_nothing_are_told() -> None:
    def said(**options: Any) -> list[str]:
        return schedule.inert(schedule.paced(TrainerOptions(members=1, **options), 3))

    assert said() == said(steps=3000, binocular=0.5) == said(binocular=0.0) == []
    assert said(binocular=0.5)[0].startswith("trainer.binocular=0.5: begins after step 300 of 300")
    assert "step 3000 of 3000" in said(steps=3000, binocular=0.5, binocular_from=1.0)[0]
    assert said(opacity_spare=0.5, opacity_decay=1.0)[0].startswith("trainer.opacity_spare=0.5: ")
    assert said(opacity_spare=0.5) == []
    assert said(tuning=0.1)[0].startswith("trainer.tuning=0.1: with trainer.members=1")


@pytest.mark.parametrize(
    ("word", "chosen"),
    [
        ("trainer.sh_every=500", {"sh_degree": 1}),
        ("trainer.lr_shN_ratio=0.1", {"sh_degree": 1}),
        ("trainer.pseudo_factor=1", {}),
        ("trainer.pseudo_steps=own", {}),
        ("trainer.coarse_octaves=true", {"coarse_factor": 4}),
        ("trainer.steps=20", {"seconds": 0.0}),
    ],
)
def test_a_typed_option_without_effect_is_told(word: str, chosen: dict[str, Any]) -> None:
    """Not what a preset or a recipe sets, nor the default."""
    key, _, value = word.removeprefix("trainer.").partition("=")
    options = {key: yaml.safe_load(value)}

    def said(*words: str, augmented: bool = False, **more: Any) -> list[str]:
        return schedule.unused(
            TrainerOptions(**{"seconds": 9.0, **options, **more}), words, augmented=augmented
        )

    (line,) = said("seed=1", f"+{word}")
    assert line.startswith(f"+{word}: ") and line.endswith("so it has no effect")
    assert said("seed=1") == said(word, augmented=True, **chosen) == []
    assert said(word, **{key: getattr(TrainerOptions, key)}) == []


def test_octaves_need_a_coarse_phase() -> None:
    options = TrainerOptions(coarse_factor=4, coarse_until=0.0, coarse_octaves=True)
    assert len(schedule.unused(options, ["trainer.coarse_octaves=true"], augmented=True)) == 1


def test_visits_that_are_too_many_are_told_by_their_own_name() -> None:
    with pytest.raises(UserError, match=r"trainer\.visits=10000: expected at most 1,000,000 steps"):
        schedule.shared(TrainerOptions(visits=10_000), 101)


def test_members_share_a_limit_of_their_number() -> None:
    def shared(members: int, **capacity: Any) -> dict[str, Any]:
        chosen = Plugins.of({**IDLE, "capacity": capacity}).shared(members).group("capacity")
        return {key: one.plugin for key, one in chosen.items()}

    assert shared(2, name="budget", gaussians=5000)["capacity"].gaussians == 2500
    assert shared(4, name="adc", max_gaussians=9)["capacity"].max_gaussians == 2
    assert shared(4, name="adc")["capacity"].max_gaussians == 0
    both = {"name": "adc+budget", "adc": {"name": "adc"}, "budget": {"name": "budget"}}
    assert shared(5, **both)["capacity.budget"].gaussians == 1000


def test_fading_ends_where_uniform_decay_ends() -> None:
    subject = textured_plane(0)[2]
    for _ in range(200):
        fade(subject, torch.zeros(len(subject)), Fading(0.5, 0.5))
    assert float(subject.opacity_logits.max()) == LOWEST_LOGIT


def test_no_depth_behind_a_mask_is_known() -> None:
    now = context()
    mask = torch.ones(now.views[0].image.shape[1:])
    mask[:, :7] = 0
    view = replace(now.views[0], mask=mask)
    reference = known_depth(replace(now, views=(view, *now.views[1:])), view)
    assert reference is not None and not reference[1][:, :7].any() and reference[1][:, 7:].any()


def test_a_photo_that_was_evened_above_one_is_warped_as_bright() -> None:
    view = photograph(camera(-0.5, 0.0))
    bright = replace(view, image=view.image * 1.5)
    actual = warp(prepare([bright], [exact(view)]), view.camera)
    inside = actual.mask > 0
    assert float(bright.image[:, inside].max()) > 1.05
    worst = (actual.image - bright.image).abs()[:, inside].max()
    assert float(worst) < 0.02


def test_photos_without_a_pixel_are_one_line_on_any_background() -> None:
    training, depth, gaussians = textured_plane(0)
    empty = tuple(replace(v, mask=torch.zeros(v.image.shape[1:])) for v in training.views)
    idle = Plugins.of(IDLE)
    with pytest.raises(UserError, match="expected valid pixels in the training views"):
        Trainer(
            replace(training, views=empty), depth, gaussians,
            TrainerOptions(steps=2, background="black"), idle, 0, Silent(),
        )  # fmt: skip


def test_a_checkpoint_that_could_not_be_read_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    trainer = trained(2)
    keeper = checkpoint.Checkpoints(tmp_path, "x", ())
    keeper.begin(0)
    keeper.keep(trainer.state())
    (kept,) = (tmp_path / "checkpoints").glob("step-*")
    kept.unlink()
    monkeypatch.setattr(checkpoint, "CHECKPOINT_BYTES", 100)
    with caplog.at_level(logging.WARNING, "framework"):
        keeper.keep(trainer.state())
    assert not list((tmp_path / "checkpoints").glob("step-*")) and not keeper.due()
    assert "starts again" in caplog.text


def test_a_pseudo_view_s_checkpoint_holds_no_photo() -> None:
    trainer = trained(12, augment={"name": "dba", "stop": 1.0})
    value = trainer.state().field.plugins["augment"].value
    state = replace(value, view=None)  # the pseudo view itself, which is as large as a photo
    photo = 4 * trainer.training.views[0].image.numel()
    assert value.made >= 0
    assert (
        len(
            checkpoint.pack(
                state,
                checkpoint.state_classes([registry.build("augment", {"name": "dba"}).plugin]),
                "x",
                "dba",
            )
        )
        < photo
    )
