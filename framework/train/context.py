"""What a plugin may see of a training at one moment: how its `StepContext` is made."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer
from framework.compute.rng import stream
from framework.fisher.information import FisherInformation
from framework.geometry import mean_neighbour_distance
from framework.options import TrainerOptions
from framework.plugin import StepContext
from framework.types import NAMES, Camera, DepthMap, Gaussians, Render, TrainingSet

if TYPE_CHECKING:
    from framework.warp.zbuffer import Support

CPU = "cpu"


@dataclass(frozen=True)
class Conditions:
    """What stays the same over a training. background: [3]. near: nothing nearer is drawn, in scene
    units. seed: of every draw. rasterizer: who draws. field: in whose name plugins draw: the
    first's is empty. made: what was asked for `once`, by its key."""

    training: TrainingSet
    depth: tuple[DepthMap, ...]
    options: TrainerOptions
    background: Tensor
    near: float
    seed: int
    rasterizer: Rasterizer = NUMBA
    field: str = ""
    made: dict[str, Any] = dataclasses.field(default_factory=dict, repr=False)

    @cached_property  # goes with the square of the number of views
    def spacing(self) -> float:
        """Mean distance of a training camera to the next; of a single one the extent."""
        cameras = [view.camera for view in self.training.views]
        return mean_neighbour_distance(cameras) or self.training.extent

    def supports(self) -> tuple[Support, ...]:
        """The training views, ready to be warped: as large as the photos, so made for who asks."""
        from framework.warp.zbuffer import prepare

        found: tuple[Support, ...] = self.once(
            "framework/supports", lambda: prepare(self.training.views, self.depth)
        )
        return found

    def once(self, key: str, make: Callable[[], Any]) -> Any:
        """See `StepContext`; a second field has what the first made."""
        if key not in self.made:
            self.made[key] = make()
        return self.made[key]


@dataclass(frozen=True)
class Moment:
    """Where a training stands. gaussians: detached. version: changes with their number or order.
    sh_degree: the active one. turn: 0 for the update on the step's real view, from 1 for those of
    pseudo views that have their own; each has draws of its own, and the first's never change.
    behind, other: see `StepContext`."""

    step: int
    epoch: int
    version: int
    gaussians: Gaussians
    sh_degree: int
    turn: int = 0
    behind: Tensor | None = None
    other: Gaussians | None = None


class Fetched(Gaussians):
    """Gaussians of another device, each tensor copied to the CPU when it is first asked for, and
    again where it has changed since: most plugins look at few of them in few steps. A gradient in
    a copy is one in its source."""

    _source: Gaussians
    _copies: dict[str, tuple[int, Tensor]]

    def __new__(cls, source: Gaussians | None = None, **tensors: Tensor) -> Any:
        """Of tensors, as `dataclasses.replace` makes another, ordinary Gaussians."""
        return Gaussians(**tensors) if source is None else super().__new__(cls)

    def __init__(self, source: Gaussians) -> None:
        object.__setattr__(self, "_source", source)
        object.__setattr__(self, "_copies", {})

    def __getattr__(self, name: str) -> Tensor:  # asked where there is no attribute
        if name not in NAMES:
            raise AttributeError(name)
        tensor: Tensor = getattr(self._source, name)
        version, copy = self._copies.get(name, (None, None))
        if copy is None or version != tensor._version:
            copy = tensor.to(CPU)
            self._copies[name] = tensor._version, copy
        return copy

    def __len__(self) -> int:
        return len(self._source)

    def to(self, device: str | torch.device) -> Gaussians:
        """The source itself where it is there already."""
        there = torch.device(device).type == self._source.means.device.type
        return self._source if there else super().to(device)


def on_cpu(gaussians: Gaussians) -> Gaussians:
    """As plugins see Gaussians, which may be on another device."""
    return gaussians if gaussians.means.device.type == CPU else Fetched(gaussians)


def step_context(
    of: Conditions, now: Moment, owner: str, log: Callable[[str, float], None]
) -> StepContext:
    """What the plugin `owner` sees now; its random draws are its own."""
    gaussians, active, rasterizer = now.gaussians, now.sh_degree, of.rasterizer
    fixed: dict[str, Any] = {"background": of.background, "near": of.near}

    def render(camera: Camera, others: Gaussians | None = None, **options: Any) -> Render:
        chosen = gaussians if others is None else others
        seen = rasterizer.render(chosen, camera, sh_degree=active, **{**fixed, **options})
        return seen if rasterizer.device == CPU else seen.to(CPU)

    def fisher(
        camera: Camera,
        others: Gaussians | None = None,
        sh_degree: int | None = None,
        mask: Tensor | None = None,
    ) -> FisherInformation:
        chosen = gaussians if others is None else others
        degree = active if sh_degree is None else sh_degree
        return rasterizer.fisher(chosen, camera, sh_degree=degree, mask=mask, **fixed)

    def rng(purpose: str) -> np.random.Generator:
        turn = f"/{now.turn}" if now.turn else ""
        return stream(of.seed, f"{of.field}{owner}/{purpose}{turn}", now.step)

    return StepContext(
        step=now.step,
        n_steps=of.options.steps,
        epoch=now.epoch,
        views=of.training.views,
        depth=of.depth,
        gaussians=on_cpu(gaussians),
        version=now.version,
        sh_degree=active,
        background=of.background,
        extent=of.training.extent,
        spacing=of.spacing,
        near=of.training.near,
        far=of.training.far,
        supports=of.supports,
        render=render,
        fisher=fisher,
        rng=rng,
        log=log,
        behind=of.background if now.behind is None else now.behind,
        other=None if now.other is None else on_cpu(now.other),
        second=bool(of.field),
        once=of.once,
    )
