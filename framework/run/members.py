"""Several trainings of one scene as one set of Gaussians (`trainer.members`).

Trainings from different draws fit the photos alike and differ in other views, by chance. The mean
of their images has less of that error; the joined set is close to the mean and one rendering. This
is the variance reduction of averaged models (Breiman 1996, "Bagging predictors"), here on volume
densities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from framework.compute import portable
from framework.compute.rng import stream
from framework.options import TrainerOptions
from framework.train.dose import joined
from framework.train.resume.training_state import Trained
from framework.types import Gaussians, concatenate

IDLE = {"augment": {"name": "none"}, "reg": {"name": "none"}, "capacity": {"name": "fixed"}}
LOWEST = 1e-13  # opacity; none for a renderer, but its logit is finite
TABLE = np.linspace(0, 1, 100_001)


def member_seed(seed: int, member: int) -> int:
    """The seed of a member's draws; the first one's is the run's."""
    return seed if member == 0 else int(stream(seed, "member", member).integers(2**62))


def second_seed(seed: int) -> int:
    """The seed of the first Gaussians of a second field with a separate draw."""
    return int(stream(seed, "second field").integers(2**62))


def join(members: Sequence[Gaussians]) -> Gaussians:
    """All Gaussians of the members, each as much thinner as there are members."""
    return concatenate([_thinner(gaussians, len(members)) for gaussians in members])


def thinner(opacities: np.ndarray, n: int) -> np.ndarray:
    """Return the opacity at which `n` coinciding Gaussians absorb as much light as one.

    The optical depth of a Gaussian of opacity o is -log(1 - o exp(-r^2 / 2)) at r standard
    deviations from its centre. Its integral over the footprint is 2 pi Li2(o), with Li2 the
    dilogarithm. So the result is Li2^-1(Li2(o) / n), for o in [0, 1].
    """
    from scipy.special import spence  # a tenth of a second, for those who join

    return np.interp(spence(1 - opacities) / n, spence(1 - TABLE), TABLE)


def tuning_options(options: TrainerOptions, steps: int) -> TrainerOptions:
    """Return the options of tuning joined members for `steps` steps.

    All rates start at the share `lr_final` and fall as in a training; opacities do not fade.

    Args:
        options: of the members, from `schedule.paced`.
    """
    return replace(
        options,
        steps=steps,
        lr_scale=options.lr_scale * options.lr_final,
        coarse_until=0.0,
        opacity_decay=1.0,
        evaluations=1,
    )


def in_turn(rounds: Sequence[Sequence[Trained]], gaussians: Gaussians) -> Trained:
    """The parts of a run as one training with the result `gaussians`.

    Parts of one round were trained at the same time. Their rows follow each other all the same, as
    if each had had the whole machine for its share of the round's seconds. Of a run that was taken
    up with another number of threads the rounds are those of the last process.
    """
    history, before, steps_before = [], 0.0, 0
    for parts in rounds:
        took, of_all = max(part.wall_s for part in parts), sum(part.wall_s for part in parts)
        share, spent = took / of_all if of_all > 0 else 1.0, 0.0
        for part in parts:
            history += [
                replace(
                    row,
                    step=row.step + steps_before,
                    seconds=before + share * (spent + row.seconds),
                )
                for row in part.history
            ]
            spent += part.wall_s
            steps_before += part.history[-1].step
        before += took
    return replace(
        rounds[-1][-1],
        gaussians=gaussians,
        history=tuple(history),
        wall_s=before,
        cpu_s=sum(part.cpu_s for parts in rounds for part in parts),
        dose=joined(part.dose for parts in rounds for part in parts),
    )


def _thinner(gaussians: Gaussians, n: int) -> Gaussians:
    opacities = 1 / (1 + portable.exp(-gaussians.opacity_logits.double().numpy()))
    thin = np.maximum(thinner(opacities, n), LOWEST)
    logits = portable.log(thin / (1 - thin)).astype(np.float32)
    return replace(gaussians, opacity_logits=torch.from_numpy(logits))
