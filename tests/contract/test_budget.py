"""`trainer.seconds`: what is chosen, that it is kept, and that its steps repeat the run."""

import dataclasses
from pathlib import Path

import pytest

from framework.options import TrainerOptions
from framework.run.budget import choose, chosen
from framework.train import schedule

MINUTE = TrainerOptions(seconds=60.0)


@pytest.mark.parametrize(
    ("step_s", "n_views", "steps", "members"),
    [(0.05, 3, 571, 2), (0.2, 3, 300, 1), (0.02, 43, 3000, 1), (0.01, 12, 1428, 3), (99, 3, 1, 1)],
)
def test_the_time_is_spent_and_not_more(
    step_s: float, n_views: int, steps: int, members: int
) -> None:
    choice = choose("a", MINUTE, n_views, step_s)
    assert (choice.steps, choice.members) == (steps, members)
    tuned = 1 + (MINUTE.tuning if members > 1 else 0)  # of all members' Gaussians
    trainings = choice.members + (choice.kept > 0)
    assert choice.steps * trainings * step_s * tuned <= max(60, step_s)


@pytest.mark.parametrize("step_s", [0.05, 0.01])
def test_the_second_camera_is_in_the_time(tmp_path: Path, step_s: float) -> None:
    """It acts in the last third of a long training, also of a trial that is as long."""

    def trial(options: TrainerOptions) -> float:
        paced = schedule.paced(options, 3)
        return step_s * options.steps * (1 + (1 - paced.binocular_from) * (paced.binocular > 0))

    choice = chosen(tmp_path, "mine", MINUTE, 3, trial)
    assert choice.step_s == pytest.approx(step_s)
    whole = dataclasses.replace(choice.applied(MINUTE), members=1)
    taken = (choice.members + (choice.kept > 0)) * trial(whole) * (1 + MINUTE.tuning)
    assert choice.members > 1 and 0.95 * 60 < taken <= 60
    off = dataclasses.replace(MINUTE, binocular=0.0)
    assert chosen(tmp_path, "off", off, 3, trial).steps > choice.steps


def test_a_choice_is_kept_for_the_same_run_alone(tmp_path: Path) -> None:
    asked: list[int] = []

    def trial(options: TrainerOptions) -> float:
        asked.append(options.steps)
        return 0.1 * options.steps * len(asked)

    first = chosen(tmp_path, "mine", MINUTE, 30, trial)
    assert asked == [8, 60, 12, 12] and first.step_s == pytest.approx(0.2)
    assert chosen(tmp_path, "mine", MINUTE, 30, trial) == first and len(asked) == 4
    assert chosen(tmp_path, "other", MINUTE, 30, trial) != first and len(asked) == 8
