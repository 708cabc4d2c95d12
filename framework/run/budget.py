"""`trainer.seconds`: as many steps as fit into a time, chosen before the training starts.

A short training of the same kind, with growth and pseudo views in proportion, measures the time of
a step. The run's folder and its record keep the choice, because the same steps give the same bits
on any machine, and the same seconds do not.
"""

from __future__ import annotations

import dataclasses
import json
from bisect import bisect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.errors import UserError
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.files.whole import write_whole
from framework.options import MOST_STEPS, TrainerOptions
from framework.train import schedule

FILE = "budget.json"
TRIAL_STEPS, TRIAL_EPOCHS = 40, 2  # of the trial, the more of both
SHARE, LONGEST_S = 0.15, 20.0  # of the given time, and seconds, that a second trial may take
WARM = 8  # steps of a first trial, which meets cold caches and is not counted
BESIDE = 12  # steps of a trial with the second camera, which no short training comes to

# trains with these options; the seconds by the wall clock that its steps took, without its start
Trial = Callable[[TrainerOptions], float]


@dataclass(frozen=True)
class Choice:
    """The training that fits into `seconds`.

    Attributes:
        step_s: measured seconds of a step without the second camera.
    """

    identity: str
    seconds: float
    step_s: float
    steps: int
    members: int
    kept: int

    def applied(self, options: TrainerOptions) -> TrainerOptions:
        """The options that repeat the run bit for bit."""
        return dataclasses.replace(
            options,
            seconds=0.0,
            visits=0,
            steps=self.steps,
            members=self.members,
            kept=self.kept,
        )

    @property
    def record(self) -> dict[str, Any]:
        """Return the values for the run's record."""
        return {
            "seconds": self.seconds,
            "step_s": self.step_s,
            "repeat": f"trainer.seconds=0 trainer.visits=0 trainer.steps={self.steps}"
            f" trainer.members={self.members} trainer.kept={self.kept}",
        }


def chosen(
    folder: Path, identity: str, options: TrainerOptions, n_views: int, trial: Trial
) -> Choice:
    """Return the choice of an interrupted process of the same run, else make and keep a new one.

    Measures about `TRIAL_STEPS` steps, then for `SHARE` of the time: early steps are slower, with
    more Gaussians and unprepared photos. A few steps with the second camera (`trainer.binocular`)
    measure its cost.

    Args:
        n_views: number of real training views.
        trial: trains with options and returns the seconds of its steps.
    """
    kept = _kept(folder / FILE, identity)
    if kept is not None:
        return kept
    # without the second camera, which a longer trial would have too
    one = dataclasses.replace(options, seconds=0.0, members=1, evaluations=1, binocular=0.0)
    steps = max(TRIAL_STEPS, TRIAL_EPOCHS * n_views)
    trial(dataclasses.replace(one, steps=WARM))
    step_s = max(1e-5, trial(dataclasses.replace(one, steps=steps)) / steps)
    longer = int(min(SHARE * options.seconds, LONGEST_S) / step_s)
    if longer > steps:
        step_s = max(1e-5, trial(dataclasses.replace(one, steps=longer)) / longer)
    without = dataclasses.replace(one, steps=BESIDE, binocular_from=0.0, pace_steps=0)
    extra = dataclasses.replace(without, binocular=options.binocular)
    ratio = max(1.0, trial(extra) / trial(without)) if options.binocular > 0 else 1.0
    choice = choose(identity, options, n_views, step_s, ratio)
    write_whole(folder / FILE, json.dumps(dataclasses.asdict(choice)) + "\n")
    return choice


def choose(
    identity: str, options: TrainerOptions, n_views: int, step_s: float, ratio: float = 1.0
) -> Choice:
    """Steps of `step_s` seconds for `options.seconds`, shared by as many trainings as pay.

    Args:
        ratio: how much longer a step with the second camera takes.
    """

    def shared(total: int) -> TrainerOptions:
        steps = max(1, total // max(1, options.members))
        return schedule.shared(dataclasses.replace(options, steps=steps, visits=0), n_views)

    def fits(total: int) -> bool:
        one = schedule.paced(shared(total), n_views)
        share = 1 - one.binocular_from if one.binocular > 0 else 0.0
        tuned = one.tuning if one.members > 1 else 0.0  # of all members' Gaussians together
        steps = one.steps * (one.members + schedule.taught(one))
        return step_s * steps * (1 + (ratio - 1) * share) * (1 + tuned) <= options.seconds

    total = max(1, bisect(range(1, MOST_STEPS + 1), 0, key=lambda n: not fits(n)))
    one = shared(total)
    return Choice(identity, one.seconds, step_s, one.steps, one.members, one.kept)


def _kept(file: Path, identity: str) -> Choice | None:
    """The choice in `file`; None where there is none of this run."""
    if not file.is_file():
        return None
    try:
        choice = Choice(**read_json(file, TEXT_BYTES))
        choice.applied(TrainerOptions())
    except (UserError, ValueError, TypeError, AttributeError, RecursionError):
        return None  # damaged: choose again
    return choice if choice.identity == identity else None
