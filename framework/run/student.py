"""A student of the joined members (`trainer.kept`): most of their accuracy in fewer Gaussians.

Joined members agree with each other more than any of them does with the truth, but they describe
the same surfaces several times. They can be rendered from any camera. So the first members'
Gaussians are trained on, with the photos and with renders of all joined members from cameras
between and around the photos. This is distillation (Hinton et al. 2015, "Distilling the knowledge
in a neural network") of an ensemble of few-view trainings; see docs/decisions.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from framework import geometry
from framework.compute.rng import stream
from framework.options import TrainerOptions
from framework.plugin import Augmenter, StepContext
from framework.toolbox.elsewhere import camera_between
from framework.train.resume.training_state import Trained
from framework.types import Camera, TrainingSet, View

SHARE = 0.75  # of a member's steps that the student of one member takes
PER_PHOTO = 1  # renders of the teacher in an epoch, for every photo
SHIFT, TURN = 0.5, 2.0  # of a camera around a photo: sigma in camera spacings, and in degrees
ALONE = 0.1  # the spacing of a single camera, in scene extents
CAMERAS, BYTES = 64, 256 * 2**20  # of the teacher at most, and of its renders


@dataclass(frozen=True)
class Teacher(Augmenter):
    """Gives each epoch some of the teacher's renders as pseudo views.

    Attributes:
        views: all renders.
    """

    name: ClassVar[str] = "teacher"
    idle: ClassVar[bool] = True  # no method of the study, so it is not in the dose

    views: tuple[View, ...] = ()

    def pseudo_views(self, ctx: StepContext, state: Any) -> tuple[list[View], Any]:
        order = ctx.rng("renders").permutation(len(self.views))
        return [self.views[i] for i in order[: PER_PHOTO * len(ctx.views)]], state


def student_options(options: TrainerOptions) -> TrainerOptions:
    """The options of the student's training.

    Rates are those of a training and fall as in one. The teacher replaces the second camera. Its
    renders are not made smaller, which would save little and lose detail (docs/decisions.md).

    Args:
        options: of the members, from `schedule.paced`.
    """
    return replace(
        options,
        steps=max(1, round(SHARE * options.steps / options.kept)),
        coarse_until=0.0,
        opacity_decay=1.0,
        binocular=0.0,
        pseudo_factor=1,
        pseudo_steps="joined",
        pseudo_mean="frame",
        evaluations=1,
    )


def teacher(training: TrainingSet, render: Callable[[Camera, None], Any], seed: int) -> Teacher:
    """Render the teacher from cameras between and around the photos.

    Args:
        training: the photos.
        render: (camera, None) -> `Render` of the teacher.
        seed: of the draws of the cameras.
    """
    size = sum(view.image.nbytes for view in training.views) // len(training.views)
    count = max(PER_PHOTO * len(training.views), min(CAMERAS, BYTES // size))
    views = []
    for k, camera in enumerate(cameras(training, seed, count)):
        image: Tensor = render(camera, None).rgb.clamp(0, 1)
        views.append(View(f"teacher {k}", camera, image))
    return Teacher(tuple(views))


def after_lesson(student: Trained, wall_s: float, cpu_s: float) -> Trained:
    """The trained student with the seconds in which its teacher was rendered.

    The renders are no pseudo views of the method, so they are not in the dose.
    """
    return replace(
        student,
        wall_s=student.wall_s + wall_s,
        cpu_s=student.cpu_s + cpu_s,
        dose={"steps": student.dose["steps"]},
    )


def cameras(training: TrainingSet, seed: int, count: int) -> list[Camera]:
    """Cameras without a photo, in turn between two photos and near one."""
    photos: Sequence[Camera] = [view.camera for view in training.views]
    spacing = geometry.mean_neighbour_distance(photos) or ALONE * training.extent
    made = []
    for k in range(count):
        rng = stream(seed, "teacher camera", k)
        first = photos[int(rng.integers(len(photos)))]
        if k % 2 == 0 and len(photos) > 1:
            made.append(camera_between(photos, first, float(rng.random()), first))
            continue
        turn = torch.from_numpy(np.radians(TURN) * rng.standard_normal(3))
        shift = torch.from_numpy(SHIFT * spacing * rng.standard_normal(3))
        made.append(geometry.perturbed(first, turn, shift))
    return made
