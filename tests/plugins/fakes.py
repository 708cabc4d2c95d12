"""A step context without a trainer: a few Gaussians, the stage's views, an invented Fisher."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from framework.compute.rng import stream
from framework.fisher.information import FisherInformation, fisher_information
from framework.geometry import mean_neighbour_distance
from framework.plugin import StepContext
from framework.types import Camera, DepthMap, Gaussians, Render, View
from framework.warp.zbuffer import prepare
from tests.warp.stage import camera, exact, photograph


@lru_cache
def stage() -> tuple[tuple[View, ...], tuple[DepthMap, ...]]:
    """Three training views of the stage, 80x60, with exact depth."""
    places = ((-0.5, 0.0), (0.5, 0.1), (0.0, -0.4))
    views = tuple(photograph(camera(x, y, size=(80, 60)), samples=2) for x, y in places)
    return views, tuple(exact(view) for view in views)


def wall_of_gaussians(n: int = 400, seed: int = 3) -> Gaussians:
    """Small Gaussians scattered over the stage's wall."""
    draws = torch.from_numpy(stream(seed, "wall").random((n, 6))).float()
    x, y = 6 * draws[:, 0] - 3, 4 * draws[:, 1] - 2
    means = torch.stack([x, y, 6 + 0.3 * x], 1)
    return Gaussians(
        means=means,
        quats=torch.tensor([1.0, 0, 0, 0]).repeat(n, 1),
        log_scales=torch.full((n, 3), -2.5) + 0.3 * draws[:, 2:3],
        opacity_logits=torch.zeros(n),
        sh0=(draws[:, None, 3:] - 0.5),
        shN=torch.zeros(n, 0, 3),
    )


@dataclass
class Log:
    """What a plugin logged, by name."""

    values: dict[str, list[float]]

    def __call__(self, name: str, value: float) -> None:
        self.values.setdefault(name, []).append(value)


def context(
    *,
    gaussians: Gaussians | None = None,
    fisher: Callable[..., FisherInformation] | None = None,
    step: int = 50,
    n_steps: int = 100,
    epoch: int = 10,
    version: int = 0,
    seed: int = 0,
    log: Log | None = None,
) -> StepContext:
    """A context in the middle of a training on the stage."""
    views, depth = stage()

    def refuse(_: Camera) -> Render:
        raise AssertionError("the plugin is not expected to render")

    def snapshot_fisher(
        camera: Camera,
        others: Gaussians | None = None,
        sh_degree: int | None = None,
        mask: Tensor | None = None,
    ) -> FisherInformation:
        assert others is not None, "the plugin should not need the current Fisher"
        how = {"background": torch.zeros(3), "sh_degree": sh_degree, "mask": mask}
        return fisher_information(others, camera, **how)

    return StepContext(
        step=step,
        n_steps=n_steps,
        epoch=epoch,
        views=views,
        depth=depth,
        gaussians=gaussians or wall_of_gaussians(),
        version=version,
        sh_degree=0,
        background=torch.zeros(3),
        extent=0.6,
        spacing=mean_neighbour_distance([view.camera for view in views]) or 0.6,
        near=2.0,
        far=8.0,
        supports=lambda: prepare(views, depth),
        render=refuse,
        fisher=fisher or snapshot_fisher,
        rng=lambda purpose: stream(seed, f"plugin/{purpose}", step),
        log=log or Log({}),
    )


def known_information(information: Tensor) -> FisherInformation:
    """`information` [N] times the identity as block and diagonal; 0 = not visible."""
    n = information.shape[0]
    block = information[:, None, None] * torch.eye(6)
    return FisherInformation(block, information[:, None].expand(n, 14).clone(), information > 0)
