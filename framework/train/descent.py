"""One update of the Gaussians: Adam's step down the losses on one or several views."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from framework.plugin import StepStats
from framework.rasterizers import NUMBA, Rasterizer
from framework.train.epoch import Item
from framework.train.gradient import Penalty, screen_gradient, step_stats, view_gradient
from framework.train.guard import diverged
from framework.train.torch_adam import Optimizer
from framework.types import Gaussians


def descend(
    params: Gaussians,
    optimizer: Optimizer,
    items: Sequence[Item],
    step: int,
    rates: Mapping[str, float],
    decay: float,
    ssim_weight: float,
    penalty: Penalty | None,
    rasterizer: Rasterizer = NUMBA,
    **rendered: Any,
) -> tuple[list[float], StepStats]:
    """Update `params` in place by the sum of the losses on the views of `items`; gives the weighted
    loss on each of them and what was seen of the first one.

    step: for messages. rates: of every tensor. decay: of the opacities. rendered: how, see
    `Rasterizer.render`. A lone view's gradient goes from the screen into Adam while the cache has
    it; the others' are summed as a whole. Raises Diverged.
    """
    first, *others = items
    where = f"training step {step} on view"
    if not others and penalty is None:
        loss, found = screen_gradient(
            params, first, _on(where, first), ssim_weight, rasterizer, **rendered
        )
        losses = [loss]
        broken, means2d = optimizer.step_from(found, rates, decay)
        stats = step_stats(first, means2d, found.radii)
    else:
        options = (ssim_weight, penalty, rasterizer)
        loss, gradients, stats = view_gradient(
            params, first, _on(where, first), *options, **rendered
        )
        losses = [loss]
        for item in others:
            loss, more, _ = view_gradient(params, item, _on(where, item), *options, **rendered)
            losses.append(loss)
            for name, gradient in more.items():
                gradients[name].add_(gradient)
        broken = optimizer.step(params, gradients, rates, decay)
    if broken:
        raise diverged(broken, _on(where, first), params.detach(), optimizer.state())
    return losses, stats


def _on(where: str, item: Item) -> str:
    return f"{where} '{item.view.name}'"
