"""Makes the `StepContext` that a plugin gets at one moment of a training."""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

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
from framework.warp.zbuffer import Support

CPU = "cpu"


@dataclass(frozen=True)
class Conditions:
    """The constants of a training.

    Attributes:
        background: [3].
        near: the near plane in scene units.
        field: prefix of the plugins' random streams, empty for the first field.
        made: values of `once` by key.
    """

    training: TrainingSet
    depth: tuple[DepthMap, ...]
    options: TrainerOptions
    background: Tensor
    near: float
    seed: int
    rasterizer: Rasterizer = NUMBA
    field: str = ""
    made: dict[str, Any] = dataclasses.field(default_factory=dict, repr=False)

    @cached_property  # costs the square of the number of views
    def spacing(self) -> float:
        """Mean distance of a training camera to the next; of a single one the extent."""
        cameras = [view.camera for view in self.training.views]
        return mean_neighbour_distance(cameras) or self.training.extent

    def supports(self) -> tuple[Support, ...]:
        """The training views prepared for warping, made on demand as they are large."""
        from framework.warp.zbuffer import prepare

        supports_: tuple[Support, ...] = self.once(
            "framework/supports", lambda: prepare(self.training.views, self.depth)
        )
        return supports_

    def once(self, key: str, make: Callable[[], Any]) -> Any:
        """See `StepContext`; both fields share the values."""
        if key not in self.made:
            self.made[key] = make()
        return self.made[key]


@dataclass(frozen=True)
class Moment:
    """A moment of a training.

    Attributes:
        version: changes with the number or order of the Gaussians.
        turn: 0 for the update on the step's real view, from 1 for separate updates of pseudo
            views. Each turn has separate draws.
        behind, other: see `StepContext`.
    """

    step: int
    epoch: int
    version: int
    gaussians: Gaussians
    sh_degree: int
    turn: int = 0
    behind: Tensor | None = None
    other: Gaussians | None = None


class Fetched(Gaussians):
    """Gaussians of another device, whose tensors are copied to the CPU on access.

    A changed tensor is copied again. Most plugins use few tensors in few steps. A gradient in a
    copy is a gradient in its source.
    """

    _source: Gaussians
    _copies: dict[str, tuple[int, Tensor]]

    def __new__(cls, source: Gaussians | None = None, **tensors: Tensor) -> Any:
        """Make ordinary Gaussians from tensors, as `dataclasses.replace` does."""
        return Gaussians(**tensors) if source is None else super().__new__(cls)

    def __init__(self, source: Gaussians) -> None:
        object.__setattr__(self, "_source", source)
        object.__setattr__(self, "_copies", {})

    def __getattr__(self, name: str) -> Tensor:  # called where there is no attribute
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
    """The Gaussians for plugins, which work on the CPU."""
    return gaussians if gaussians.means.device.type == CPU else Fetched(gaussians)


def step_context(
    of: Conditions, now: Moment, owner: str, log: Callable[[str, float], None]
) -> StepContext:
    """Make the context of a plugin; `owner` names its random streams."""
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
