"""Every plugin's state goes through a checkpoint file and the training ends with the same bits."""

import dataclasses
from pathlib import Path
from typing import Any

import pytest

from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.records.record import parameters_sha256
from framework.run.plane import textured_plane
from framework.train.resume.checkpoint import Checkpoints
from framework.train.resume.state_check import check_state
from framework.train.resume.training_state import TrainerState
from framework.train.trainer import Plugins, Trained, Trainer
from tests.contract.test_training import ACTING, ALL, EAGER, NEUTRAL, content_sha256

OPTIONS = TrainerOptions(steps=20, sh_degree=1, sh_every=4, evaluations=2)
TAKEN_UP_AT = (7, 19)  # inside an epoch, at several of the plugins' moments, before the last
# bands go while SAFI still has a snapshot with them
DROPPING = {"augment": "safi", "capacity": "evidence"}


class Files:
    """Writes chosen states with a run's `Checkpoints` and gives them back as another process
    would read them."""

    def __init__(self, folder: Path, plugins: Plugins, sh_degree: int = 1) -> None:
        chosen = [one.plugin for one in plugins.each.values()]
        self.folder, self.chosen, self.seen = folder, chosen, dict[int, str]()
        self.options = dataclasses.replace(OPTIONS, sh_degree=sh_degree)

    def due(self) -> bool:
        return True

    def checkpoints(self, step: int) -> Checkpoints:
        return Checkpoints(self.folder / str(step), "identity", self.chosen)

    def check(self, state: TrainerState) -> None:
        plugins = dict(zip(NEUTRAL, self.chosen, strict=True))
        check_state(state, textured_plane(1)[0], self.options, plugins)

    def keep(self, state: TrainerState) -> None:
        if state.step in TAKEN_UP_AT:
            self.checkpoints(state.step).keep(state)
            self.seen[state.step] = content_sha256(tuple(state.field.plugins.values()))


def plugins(**names: str) -> Plugins:
    span = {"start": 0.0, "stop": 1.0}
    chosen = {**NEUTRAL, **names}.items()
    return Plugins.of({group: {"name": n, **EAGER.get(n, {}), **span} for group, n in chosen})


def train(
    chosen: Plugins,
    keeper: Any = None,
    start: TrainerState | None = None,
    sh_degree: int = 1,
    **changes: Any,
) -> Trained:
    options = dataclasses.replace(OPTIONS, sh_degree=sh_degree, **changes)
    scene = textured_plane(sh_degree)
    return Trainer(*scene, options, chosen, 0, Silent(), lambda *_: 1.5, keeper, start).run()


def outcome(trained: Trained) -> tuple[Any, ...]:
    """All of a training but its times; also how much of its methods it got."""
    rows = [(r.step, r.loss, r.gaussians, r.test_psnr, dict(r.logged)) for r in trained.history]
    return parameters_sha256(trained.gaussians), rows, trained.sh_degree, dict(trained.dose)


@pytest.mark.parametrize(
    ("names", "sh_degree"),
    [*(({group: name}, 1) for group, name in ALL), (ACTING, 3), (DROPPING, 1)],
    ids=lambda value: "+".join(value.values()) if isinstance(value, dict) else f"sh{value}",
)
def test_a_training_taken_up_again_ends_with_the_same_bits(
    names: dict[str, str], sh_degree: int, tmp_path: Path
) -> None:
    """And every tensor of the plugin's state comes back with its type, shape and bits."""
    chosen = plugins(**names)
    files = Files(tmp_path, chosen, sh_degree)
    whole = train(chosen, files, sh_degree=sh_degree)
    assert whole.sh_degree == whole.gaussians.sh_degree <= sh_degree
    for step in TAKEN_UP_AT:
        state = files.checkpoints(step).newest(files.check)
        assert state is not None and state.step == step
        assert content_sha256(tuple(state.field.plugins.values())) == files.seen[step]
        again = train(chosen, start=state, sh_degree=sh_degree)
        assert outcome(again) == outcome(whole)
        assert again.resumed == 1 and again.wall_s > state.wall_s


def test_updates_of_pseudo_views_alone_are_taken_up_too(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A training has more updates than steps then, and Adam counts them; the final report is
    of the whole training."""
    chosen = plugins(**ACTING)
    augment = chosen.each["augment"]
    rare = dataclasses.replace(augment.plugin, min_coverage=0.98)
    augment = dataclasses.replace(augment, plugin=rare)
    chosen = Plugins({**chosen.each, "augment": augment})
    files = Files(tmp_path, chosen)
    ours: dict[str, Any] = {"pseudo_steps": "own", "pseudo_mean": "covered"}
    whole = train(chosen, files, **ours)
    asked, built = whole.dose["augment.asked"]
    assert asked == 7 and 0 < built < asked
    assert whole.dose["steps"][0] == OPTIONS.steps + whole.dose["loss.pseudo"][0] > OPTIONS.steps
    messages = [record.getMessage() for record in caplog.records]
    for step in TAKEN_UP_AT:
        caplog.clear()
        state = files.checkpoints(step).newest(files.check)
        assert state is not None and max(state.field.adam.steps) == state.dose["steps"][0]
        assert outcome(train(chosen, start=state, **ours)) == outcome(whole)
        assert [record.getMessage() for record in caplog.records] == messages


@pytest.mark.parametrize(
    "dose", [[], {1: (0, 0.0)}, {"a": (0,)}, {"a": (-1, 0.0)}, {"a": (1, "x")}, {"a": [1, 0.0]}]
)
def test_a_forged_dose_is_refused(dose: Any, tmp_path: Path) -> None:
    chosen = plugins()
    files = Files(tmp_path, chosen)
    train(chosen, files)
    state = files.checkpoints(7).newest(files.check)
    assert state is not None
    with pytest.raises(ValueError, match="dose"):
        files.check(dataclasses.replace(state, dose=dose))


def test_keeping_changes_nothing(tmp_path: Path) -> None:
    chosen = plugins(**ACTING)
    assert outcome(train(chosen, Files(tmp_path, chosen))) == outcome(train(chosen))
