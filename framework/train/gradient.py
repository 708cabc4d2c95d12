"""The training loss on one view and its gradient in every parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer, RenderGradient
from framework.plugin import StepStats
from framework.train.depth_terms import DepthTerms
from framework.train.epoch import Item
from framework.train.guard import check_loss
from framework.types import Gaussians, Render, View

Penalty = Callable[[View, Render], Tensor | float]
ViewGradient = tuple[float, dict[str, Tensor], StepStats]


def screen_gradient(
    params: Gaussians,
    item: Item,
    where: str,
    ssim_weight: float,
    rasterizer: Rasterizer = NUMBA,
    absolute: bool = False,
    terms: DepthTerms | None = None,
    **rendered: Any,
) -> tuple[float, RenderGradient]:
    """The loss on a view, and its gradient as far back as the rasterizer takes it at first, which
    is the screen. What is asked of depth is in the gradient and not in the loss that is told.

    where: for messages. absolute, rendered: the options of `Rasterizer.render_gradient`. terms: of
    depth, those of the view by default; the gradient in another render is left to who gave them.
    Raises Diverged when the loss is not finite.
    """
    terms = DepthTerms(params, item, rasterizer, **rendered) if terms is None else terms
    view, loss = item.view, 0.0

    def image_gradient(rgb: Any) -> Any:
        nonlocal loss
        loss, gradient = rasterizer.loss_gradient(rgb, item.target, ssim_weight, view.weight)
        check_loss(loss, where, params)
        return gradient

    found = rasterizer.render_gradient(
        params,
        view.camera,
        image_gradient,
        absolute=absolute,
        depth_gradient=terms if terms.any else None,
        **rendered,
    )
    return loss, found


def view_gradient(
    params: Gaussians,
    item: Item,
    where: str,
    ssim_weight: float,
    penalty: Penalty | None = None,
    rasterizer: Rasterizer = NUMBA,
    absolute: bool = False,
    **rendered: Any,
) -> ViewGradient:
    """The photometric loss on a view, the gradient of it and of all terms beside by the parameters'
    names, and what capacity plugins see.

    penalty: a term that is added, of whatever its plugin likes, hence by autograd, which cannot
    tell pixels apart: `absolute` takes a render of its own beside one. Without a penalty the
    gradient is taken directly, with the same bits. The others as for `screen_gradient`.
    """
    how = (params, item, where, ssim_weight)
    if penalty is not None:
        loss, parameters, stats = _by_autograd(*how, penalty, rasterizer, **rendered)
        if absolute:
            item = replace(item, smoothing=None, beside=None)  # it is of the colours alone
            how = (params, item, where, ssim_weight)
            _, found = screen_gradient(*how, rasterizer, absolute=True, **rendered)
            found.drop()
            stats = replace(stats, absolute=found.absolute)
        return loss, parameters, stats
    terms = DepthTerms(params, item, rasterizer, **rendered)
    loss, found = screen_gradient(*how, rasterizer, absolute, terms, **rendered)
    parameters, means2d = found.pull_back()
    stats = step_stats(item, means2d, found.radii, found.absolute, **rendered)
    return loss, terms.added(parameters), stats


def step_stats(
    item: Item,
    means2d: Tensor,
    radii: Tensor,
    absolute: Tensor | None = None,
    opacity_factors: Tensor | None = None,
    **_: Any,
) -> StepStats:
    """What capacity plugins see of a view's render, which had these options, and its gradient."""
    view = item.view
    size = view.camera.width, view.camera.height
    return StepStats(means2d, radii, *size, factors=opacity_factors, view=view, absolute=absolute)


def _by_autograd(
    params: Gaussians,
    item: Item,
    where: str,
    ssim_weight: float,
    penalty: Penalty,
    rasterizer: Rasterizer,
    **rendered: Any,
) -> ViewGradient:
    view, offset = item.view, params.means.new_zeros(len(params), 2, requires_grad=True)
    render = rasterizer.render(params, view.camera, means2d_offset=offset, **rendered)
    loss = rasterizer.loss(render.rgb, item.target, ssim_weight) * view.weight
    photometric = float(loss.detach())
    check_loss(photometric, where, params)
    loss = loss + penalty(view, render)  # one that is not finite is its plugin's
    tensors, outputs, pulls = dict(params.items()), [loss], [torch.ones_like(loss)]
    terms = DepthTerms(params, item, rasterizer, **rendered)
    if terms.any:
        outputs += [render.alpha, render.depth]
        pulls += map(torch.as_tensor, terms(render.alpha.detach(), render.depth.detach()))
    *gradients, means2d = torch.autograd.grad(
        outputs, [*tensors.values(), offset], pulls, materialize_grads=True
    )
    stats = step_stats(item, means2d, render.radii, **rendered)
    return photometric, terms.added(dict(zip(tensors, gradients, strict=True))), stats
