"""What a plugin may see of a training at one moment: how its `StepContext` is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from framework.compute.rng import stream
from framework.fisher.information import FisherInformation, fisher_information
from framework.options import TrainerOptions
from framework.plugin import StepContext
from framework.rasterize import rasterize
from framework.types import Camera, DepthMap, Gaussians, Render, TrainingSet


@dataclass(frozen=True)
class Conditions:
    """What stays the same over a training. background: [3]. near: nothing nearer is drawn, in scene
    units. seed: of every draw."""

    training: TrainingSet
    depth: tuple[DepthMap, ...]
    options: TrainerOptions
    background: Tensor
    near: float
    seed: int


@dataclass(frozen=True)
class Moment:
    """Where a training stands. gaussians: detached. version: changes with their number or order.
    sh_degree: the active one. turn: 0 for the update on the step's real view, from 1 for those of
    pseudo views that have their own; each has draws of its own, and the first's never change."""

    step: int
    epoch: int
    version: int
    gaussians: Gaussians
    sh_degree: int
    turn: int = 0


def step_context(
    of: Conditions, now: Moment, group: str, log: Callable[[str, float], None]
) -> StepContext:
    """What the plugin of `group` sees now; its random draws are its own."""
    gaussians, active = now.gaussians, now.sh_degree
    fixed: dict[str, Any] = {"background": of.background, "near": of.near}

    def render(camera: Camera) -> Render:
        return rasterize(gaussians, camera, sh_degree=active, **fixed)

    def fisher(
        camera: Camera, others: Gaussians | None = None, sh_degree: int | None = None
    ) -> FisherInformation:
        chosen = gaussians if others is None else others
        degree = active if sh_degree is None else sh_degree
        return fisher_information(chosen, camera, sh_degree=degree, **fixed)

    def rng(purpose: str) -> np.random.Generator:
        turn = f"/{now.turn}" if now.turn else ""
        return stream(of.seed, f"{group}/{purpose}{turn}", now.step)

    return StepContext(
        step=now.step,
        n_steps=of.options.steps,
        epoch=now.epoch,
        views=of.training.views,
        depth=of.depth,
        gaussians=gaussians,
        version=now.version,
        sh_degree=active,
        background=of.background,
        extent=of.training.extent,
        near=of.training.near,
        far=of.training.far,
        render=render,
        fisher=fisher,
        rng=rng,
        log=log,
    )
