"""One update of the Gaussians: Adam's step down the losses on one or several views."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.backends import Rasterizer
from framework.compute import portable
from framework.plugin import GradientAt, StepStats
from framework.train.adam_kernels import LOWEST_LOGIT
from framework.train.epoch import Item
from framework.train.gradient import Penalty, screen_gradient, step_stats, view_gradient
from framework.train.guard import check_loss, diverged
from framework.train.optimizer import Optimizer
from framework.types import Gaussians

Gradients = Mapping[str, Tensor]
TINY = 1e-30  # an opacity that has a logit


@dataclass(frozen=True)
class Regularization:
    """What regularizers make of an update; nothing by default.

    factors: [N] of the opacities. penalty: of some Gaussians, what the loss terms add to the loss
    on a render of them; None for nothing. mixed: the gradient that the optimizer gets, of the
    loss's own and of what gives it elsewhere.
    """

    factors: Tensor | None = None
    penalty: Callable[[Gaussians], Penalty] | None = None
    mixed: Callable[[Gradients, GradientAt], Gradients] | None = None


@dataclass(frozen=True)
class Fading:
    """Opacities are multiplied by `decay` in (0, 1] after an update. spare: a Gaussian whose
    opacity the loss pulls at as hard as at the mean one's loses exp(-spare) of that, see `fade`."""

    decay: float = 1.0
    spare: float = 0.0

    @property
    def alike(self) -> bool:
        """Whether all Gaussians fade alike, which the optimizer does on its way."""
        return self.spare == 0 or self.decay == 1


def descend(
    params: Gaussians,
    optimizer: Optimizer,
    items: Sequence[Item],
    step: int,
    rates: Mapping[str, float],
    fading: Fading,
    ssim_weight: float,
    acting: Regularization,
    wanted: Sequence[str],
    rasterizer: Rasterizer,
    absolute: bool,
    **rendered: Any,
) -> tuple[list[float], StepStats]:
    """Update `params` in place by the sum of the losses on the views of `items`; gives the
    weighted loss on each of them and what was seen of the first one.

    step: for messages. rates: of every tensor. wanted: the parameters whose gradient the capacity
    sees. absolute: whether it sees the absolute gradient on the screen. rendered: how, see
    `Rasterizer.render`, but for the factors of `acting`. A lone view's gradient goes from the
    screen into Adam while the cache has it, unless somebody looks at it; the others' are summed as
    a whole. Raises Diverged.
    """
    first, rendered = items[0], {**rendered, "opacity_factors": acting.factors}
    where = _on(f"training step {step} on view", first)
    looked_at = acting.penalty or acting.mixed or wanted or first.beside or not fading.alike
    if len(items) == 1 and not looked_at:
        how = (where, ssim_weight, rasterizer)
        loss, found = screen_gradient(params, first, *how, absolute=absolute, **rendered)
        losses = [loss]
        broken, means2d = optimizer.step_from(found, rates, fading.decay)
        stats = step_stats(first, means2d, found.radii, found.absolute, **rendered)
    else:

        def whole(of: Gaussians, seen: bool = False) -> tuple[list[float], Gradients, StepStats]:
            penalty = None if acting.penalty is None else acting.penalty(of)
            options = (ssim_weight, penalty, rasterizer, seen)
            return _summed(of, items, step, wanted, *options, **rendered)

        losses, gradients, stats = whole(params, absolute)
        if acting.mixed is not None:
            gradients = acting.mixed(gradients, lambda other: whole(other.leaves())[1])
        decay = fading.decay if fading.alike else 1.0
        broken = optimizer.step(params, gradients, rates, decay)
        if not fading.alike:
            fade(params, gradients["opacity_logits"], fading)
    if broken:
        raise diverged(broken, where, params.detach(), optimizer.state())
    return losses, stats


def substep(
    params: Gaussians,
    optimizer: Optimizer,
    loss: Tensor,
    names: Sequence[str],
    step: int,
    rates: Mapping[str, float],
) -> None:
    """One step of the optimizer down `loss`, a scalar of `params`, of the tensors `names` alone.
    Raises Diverged."""
    where = f"a regularizer's own update in training step {step}"
    check_loss(float(loss.detach()), where, params)
    tensors = dict(params.items())
    found = torch.autograd.grad(loss, [tensors[name] for name in names], allow_unused=True)
    broken = optimizer.step(params, dict(zip(names, found, strict=True)), rates)
    if broken:
        raise diverged(broken, where, params.detach(), optimizer.state())


def fade(params: Gaussians, in_logits: Tensor, fading: Fading) -> None:
    """Multiply every opacity in place by 1 - (1 - decay) exp(-spare g / mean g), g the size of the
    loss's gradient in it (StereoGS 2026, its relative opacity decay, with spare = 0.5): what the
    photos hold on to fades less.

    in_logits: [N], the gradient in the logits.
    """
    with torch.no_grad():
        logits = params.opacity_logits
        opacities = portable.sigmoid(logits.cpu().numpy())
        pull = np.abs(in_logits.cpu().numpy()) / np.maximum(opacities * (1 - opacities), 1e-12)
        relative = pull / max(float(pull.mean()), 1e-30)
        factors = 1 - (1 - fading.decay) * portable.exp(-fading.spare * relative)
        kept = factors < 1  # an opacity of 1 has no logit
        faded = portable.logit(np.where(kept, np.maximum(opacities * factors, TINY), 0.5))
        faded = np.maximum(faded, LOWEST_LOGIT)
        logits.copy_(
            torch.where(
                torch.from_numpy(kept).to(logits.device), torch.from_numpy(faded).to(logits), logits
            )
        )


def _summed(
    params: Gaussians,
    items: Sequence[Item],
    step: int,
    wanted: Sequence[str],
    ssim_weight: float,
    penalty: Penalty | None,
    rasterizer: Rasterizer,
    absolute: bool,
    **rendered: Any,
) -> tuple[list[float], dict[str, Tensor], StepStats]:
    """(loss on each view, gradient of their sum in every parameter, what was seen of the first)."""
    options = (ssim_weight, penalty, rasterizer)
    where = f"training step {step} on view"
    first, *others = items
    loss, gradients, stats = view_gradient(
        params, first, _on(where, first), *options, absolute, **rendered
    )
    losses = [loss]
    if wanted:
        stats = replace(stats, gradients={name: gradients[name].clone() for name in wanted})
    for item in others:
        loss, more, _ = view_gradient(params, item, _on(where, item), *options, **rendered)
        losses.append(loss)
        for name, gradient in more.items():
            gradients[name].add_(gradient)
    return losses, gradients, stats


def _on(where: str, item: Item) -> str:
    return f"{where} '{item.view.name}'"
