"""Step contexts that can render, and renders and depth that are known."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from framework.kernels import rasterize
from framework.plugin import StepContext
from framework.types import Camera, Gaussians, Render, View
from tests.plugins.fakes import context


def at_work(**changes: Any) -> StepContext:
    """A context whose Gaussians are parameters and can be rendered from anywhere."""
    ctx = context(**{k: v for k, v in changes.items() if k in ("gaussians", "step", "seed", "log")})
    gaussians = ctx.gaussians.map(lambda t: t.clone().requires_grad_())

    def render(camera: Camera, others: Gaussians | None = None, **options: Any) -> Render:
        chosen = ctx.gaussians if others is None else others
        return rasterize(chosen, camera, **{"background": torch.zeros(3), **options})

    ours = {k: v for k, v in changes.items() if k in ("other", "second", "depth", "views")}
    return replace(ctx, gaussians=gaussians, render=render, behind=torch.zeros(3), **ours)


def shown(depth: Tensor, alpha: float = 1.0, n: int = 1) -> Render:
    """A render of this expected depth."""
    full = torch.full(depth.shape, alpha)
    return Render(torch.zeros(3, *depth.shape), full, depth * alpha, torch.ones(n))


def true_depth() -> tuple[StepContext, View, Tensor]:
    """A context, its first view and the known depth there."""
    ctx = context()
    return ctx, ctx.views[0], ctx.depth[0].depth
