"""How rates and decay follow the number of steps and views: `framework.train.schedule.paced`."""

from typing import Any

import pytest

from framework.options import TrainerOptions
from framework.run.members import tuning_options
from framework.train import schedule

BASE = TrainerOptions()


def way(options: TrainerOptions, n_views: int) -> float:
    """The sum of the means' rates over a training: how far Adam can move them, in extents."""
    paced = schedule.paced(options, n_views)
    rates = [schedule.learning_rates(paced, step, 1.0)["means"] for step in range(options.steps)]
    return sum(rates)


@pytest.mark.parametrize("steps", [1_000, 10_000])
def test_a_longer_training_goes_the_same_way_and_fades_as_much(steps: int) -> None:
    longer = TrainerOptions(steps=steps)
    assert way(longer, 3) == pytest.approx(way(BASE, 3), rel=0.01)
    faded = schedule.paced(longer, 3).opacity_decay ** steps
    assert faded == pytest.approx(BASE.opacity_decay**BASE.steps, rel=1e-6)


def test_the_reference_and_what_is_shorter_or_has_fewer_views_keep_their_rates() -> None:
    for steps, n_views in ((300, 3), (75, 3), (300, 1), (1, 2)):
        paced = schedule.paced(TrainerOptions(steps=steps), n_views)
        assert (paced.lr_scale, paced.opacity_decay) == (BASE.lr_scale, BASE.opacity_decay)


def test_more_views_slow_the_rates_a_little_and_the_fading_in_proportion() -> None:
    paced = schedule.paced(BASE, 12)
    assert paced.lr_scale == pytest.approx(BASE.lr_scale * 4**-schedule.VIEWS_EXPONENT)
    assert paced.opacity_decay**4 == pytest.approx(BASE.opacity_decay)


def test_a_training_is_long_only_when_it_visits_every_view_often() -> None:
    steps = schedule.VISITS * 43
    slowed = [schedule.paced(TrainerOptions(steps=n), 43).lr_scale for n in (300, steps, 2 * steps)]
    assert slowed[0] == slowed[1] == pytest.approx(2 * slowed[2])


@pytest.mark.parametrize(
    ("steps", "n_views", "expected"),
    [
        (300, 3, (1, 300)),
        (599, 3, (1, 599)),
        (600, 3, (2, 300)),
        (2400, 3, (4, 600)),
        (10_000, 3, (8, 1250)),
        (2400, 12, (3, 800)),
        (2400, 43, (1, 2400)),
        (12_000, 43, (3, 4000)),
    ],
)
def test_steps_are_shared_by_as_many_trainings_as_the_views_leave_them_for(
    steps: int, n_views: int, expected: tuple[int, int]
) -> None:
    one = schedule.shared(TrainerOptions(steps=steps, kept=0), n_views)
    assert (one.members, one.steps) == expected
    assert schedule.shared(one, n_views) == one
    taught = schedule.shared(TrainerOptions(steps=steps), n_views)
    assert (taught.members + schedule.taught(taught), taught.steps) == expected
    assert schedule.taught(taught) == (expected[0] >= 3)


def test_the_second_camera_waits_for_the_steps_that_the_views_pay_for() -> None:
    def share(steps: int, n_views: int, **options: Any) -> float:
        inputs = TrainerOptions(steps=steps, **options)
        return schedule.paced(inputs, n_views).binocular_from

    assert [share(steps, 3) for steps in (75, 300, 375, 600, 3000)] == [1, 1, 0.8, 0.667, 0.667]
    assert share(2430, 43) == pytest.approx(1720 / 2430)
    assert share(2000, 3, binocular_from=0.1) == pytest.approx(0.15)
    assert share(75, 3, pace_steps=0) == 0.667
    once = schedule.paced(TrainerOptions(steps=600), 3)
    tuned = schedule.paced(tuning_options(once, 30), 3)
    assert tuned.binocular_from == 0.667  # a share of its steps, as in the members
