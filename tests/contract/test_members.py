"""Several trainings whose Gaussians are joined: `trainer.members`."""

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from framework.compute.parallel import set_threads
from framework.geometry import distance, mean_neighbour_distance, moved_aside
from framework.metrics.evaluate import psnr
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.records.record import DIVERGED, parameters_sha256
from framework.run import student
from framework.run.members import join, member_seed, thinner
from framework.run.plane import textured_plane
from framework.run.training import Run, renderer, train
from framework.train.guard import Diverged
from framework.train.resume.checkpoint import Checkpoints
from framework.train.trainer import Trained
from framework.types import Gaussians, Scene
from tests.contract.test_training import EAGER

OPTIONS = TrainerOptions(steps=12, sh_degree=1, sh_every=4, evaluations=2, members=2, tuning=0.5)
STEPS = 2 * 12 + 6 + 9  # of the members, their tuning and their student
METHOD = {"augment": "safi", "reg": "uar", "capacity": "adc"}


class Stopping(Silent):
    """Ends the process, so to speak, after step `at` of all."""

    def __init__(self, at: int = 10**9) -> None:
        self.at, self.told = at, list[tuple[int, int]]()
        self.notes, self.stages = list[str](), list[str]()

    def stage(self, what: str) -> None:
        self.stages.append(what)

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        self.told.append((step, n_steps))
        if step == self.at:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    yield
    set_threads(0)


def start(seed: int) -> Gaussians:
    """Another set for every seed."""
    gaussians = textured_plane(1)[2]
    gaussians.means[:, 0] += 1e-3 * (seed % 1000)
    return gaussians


def trained(
    folder: Path,
    progress: Stopping | None = None,
    seed: int = 0,
    n_threads: int = 1,
    capacity: dict[str, Any] | None = None,
    **changes: Any,
) -> Trained:
    set_threads(n_threads)
    views, depth, _ = textured_plane(1)
    run = Run(Scene("plane", "own", views, views.views[:1], "f"), depth, start, folder, "id", False)
    choices = {
        group: {"name": name, **EAGER.get(name, {}), "start": 0.0, "stop": 1.0}
        for group, name in METHOD.items()
    }
    if capacity is not None:
        choices["capacity"] = capacity
    options = dataclasses.replace(OPTIONS, **changes)
    config = {**choices, "seed": seed, "trainer": asdict(options)}
    return train(run, config, progress or Stopping())


def test_a_thinner_gaussian_has_its_share_of_the_optical_depth() -> None:
    def depth(opacity: float) -> float:  # over the footprint, r in standard deviations
        return quad(lambda r: -np.log(1 - opacity * np.exp(-r * r / 2)) * r, 0, 12)[0]

    for n in (2, 3, 8):
        for opacity in (0.01, 0.3, 0.9, 0.999):
            thin = float(thinner(np.array([opacity]), n)[0])
            assert depth(thin) == pytest.approx(depth(opacity) / n, rel=1e-4)
    assert thinner(np.array([0.0, 0.5]), 1) == pytest.approx([0.0, 0.5])


def test_a_model_joined_with_itself_renders_as_before(tmp_path: Path) -> None:
    one = trained(tmp_path, members=1, steps=24, evaluations=1)
    camera = textured_plane(1)[0].views[0].camera
    before, *joined = (
        renderer(gaussians, one.background, one.sh_degree, 0.01)(camera)
        for gaussians in (one.gaussians, *(join([one.gaussians] * n) for n in (2, 3)))
    )
    for image in joined:
        difference = psnr(image, before)
        assert isinstance(difference, float) and difference > 32


def test_the_first_member_is_the_training_of_one(tmp_path: Path) -> None:
    alone = trained(tmp_path / "a", members=1)
    joined = trained(tmp_path / "b")
    first = joined.history[: len(alone.history)]
    assert [(row.step, row.loss) for row in first] == [(r.step, r.loss) for r in alone.history]
    assert member_seed(0, 0) == 0
    assert len({member_seed(seed, k) for seed in range(3) for k in range(3)}) == 9


def test_members_that_diverge_at_the_same_time_end_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = textured_plane(1)[2].map(lambda tensor: tensor * math.nan)
    monkeypatch.setitem(globals(), "start", lambda seed: broken.clone())
    for k in range(3):
        with pytest.raises(Diverged, match=r"member \d, training step 0 .*the state is in"):
            trained(tmp_path / str(k), n_threads=2)
        assert [path.name for path in (tmp_path / str(k)).iterdir()] == [DIVERGED]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """An uninterrupted training."""
    return trained(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize(("at", "n_threads"), [(12, 1), (17, 2), (27, 1), (35, 1)])
def test_an_interrupted_one_ends_with_the_same_bits(
    tmp_path: Path, at: int, n_threads: int, monkeypatch: pytest.MonkeyPatch, whole: Any
) -> None:
    """In a member, between two, in tuning and student; one after another and at the same time."""
    monkeypatch.setattr(Checkpoints, "due", lambda self: True)
    with pytest.raises(KeyboardInterrupt):
        trained(tmp_path / "run", Stopping(at), n_threads=n_threads)
    progress = Stopping()
    again = trained(tmp_path / "run", progress, n_threads=n_threads)
    assert parameters_sha256(again.gaussians) == parameters_sha256(whole.gaussians)
    assert [(r.step, r.loss) for r in again.history] == [(r.step, r.loss) for r in whole.history]
    # the other member may have finished the step that it was in, and begun another
    assert at <= progress.told[0][0] <= at + 3 * (n_threads - 1) and again.resumed == 1
    assert progress.notes == [f"going on at step {progress.told[0][0] - 1} of {STEPS}"]


@pytest.mark.parametrize(("members", "steps"), [(1, 12), (2, STEPS)])
def test_one_that_had_ended_counts_as_taken_up(
    tmp_path: Path, members: int, steps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its process was killed before the results were written."""
    monkeypatch.setattr(Checkpoints, "due", lambda self: True)
    whole, progress = trained(tmp_path, members=members), Stopping()
    again = trained(tmp_path, progress, members=members)
    assert progress.told == [] and again.resumed == 1 and len(progress.notes) == 1
    assert parameters_sha256(again.gaussians) == parameters_sha256(whole.gaussians)
    assert again.history[-1].step == steps


def test_a_student_has_the_gaussians_of_the_members_it_keeps(tmp_path: Path) -> None:
    sizes = [
        len(trained(tmp_path / str(kept), members=3, kept=kept).gaussians) for kept in (1, 2, 0)
    ]
    assert sizes == sorted(sizes) and sizes[0] < sizes[2] / 2
    budget = {"name": "budget", "gaussians": 70, "start": 0.0, "stop": 1.0}
    few = trained(tmp_path / "budget", members=3, steps=24, capacity=budget)
    assert len(few.gaussians) == 70  # all of the budget, not a member's share
    # as many members as are kept have nothing to learn
    both = [trained(tmp_path / f"two {kept}", members=2, kept=kept) for kept in (2, 0)]
    assert len({parameters_sha256(one.gaussians) for one in both}) == 1


def test_a_student_approaches_its_teacher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Seen from beside the photos, more closely than with as many steps on photos alone."""
    fixed = {"name": "fixed", "start": 0.0, "stop": 1.0}  # the eager ADC would add a million
    taught, joined = (trained(tmp_path / str(k), kept=k, steps=60, capacity=fixed) for k in (1, 0))
    monkeypatch.setattr(student, "PER_PHOTO", 0)
    alone = trained(tmp_path / "alone", kept=1, steps=60, capacity=fixed)
    camera = moved_aside(textured_plane(1)[0].views[0].camera, 0.05)
    of_taught, of_joined, of_alone = (
        renderer(one.gaussians, one.background, one.sh_degree, 0.01)(camera)
        for one in (taught, joined, alone)
    )
    assert psnr(of_taught, of_joined) > psnr(of_alone, of_joined)  # type: ignore[operator]


def test_the_teacher_stands_between_and_around_the_photos() -> None:
    training = textured_plane(1)[0]
    made = student.cameras(training, 0, 8)
    assert len({tuple(camera.center.tolist()) for camera in made}) == 8
    spacing = mean_neighbour_distance([view.camera for view in training.views])
    for camera in made:
        nearest = min(distance(camera, view.camera) for view in training.views)
        assert nearest < 4 * 0.5 * (spacing or training.extent)
