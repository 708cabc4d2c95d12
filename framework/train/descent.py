"""One update of the Gaussians: a step of Adam on the losses of one or several views."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from framework.compute import portable
from framework.plugin import GradientAt, StepStats
from framework.train.adam_kernels import LOWEST_LOGIT
from framework.train.epoch import Item
from framework.train.gradient import Penalty, Rendering, screen_gradient, step_stats, view_gradient
from framework.train.guard import check_loss, diverged
from framework.train.optimizer import Optimizer
from framework.types import Gaussians

Gradients = Mapping[str, Tensor]
TINY = 1e-30  # an opacity that has a logit


@dataclass(frozen=True)
class Regularization:
    """Contribution of the regularizers to an update; nothing by default.

    Attributes:
        factors: [N], multiply the opacities.
        penalty: makes the added loss term for some Gaussians.
        gradient: replaces the loss's gradient.
    """

    factors: Tensor | None = None
    penalty: Callable[[Gaussians], Penalty] | None = None
    gradient: Callable[[Gradients, GradientAt], Gradients] | None = None


@dataclass(frozen=True)
class Fading:
    """Opacities are multiplied by `decay` in (0, 1] after an update. With `spare` > 0 those with a
    larger gradient fade less, see `fade`."""

    decay: float = 1.0
    spare: float = 0.0

    @property
    def uniform(self) -> bool:
        """Whether all Gaussians fade alike, which the optimizer does in passing."""
        return self.spare == 0 or self.decay == 1


@dataclass(frozen=True)
class Update:
    """Settings of an update.

    Attributes:
        rates: learning rate of every tensor.
        rendering: without opacity factors.
        requested: parameters whose gradient a capacity sees.
        absolute: whether a capacity sees absolute gradients.
    """

    step: int
    rates: Mapping[str, float]
    rendering: Rendering
    regularization: Regularization
    fading: Fading
    requested: Sequence[str] = ()
    absolute: bool = False

    def place(self, item: Item) -> str:
        """The place of a view's loss, for messages."""
        return f"training step {self.step} on view '{item.view.name}'"


def descend(
    params: Gaussians, optimizer: Optimizer, items: Sequence[Item], update: Update
) -> tuple[list[float], StepStats]:
    """Update `params` in place by the sum of the losses on the views of `items`.

    The gradient of a single view goes from the screen into Adam while the cache has it, unless
    something needs it as a whole.

    Returns:
        The weighted loss on each view, and the stats of the first view.

    Raises:
        Diverged: the loss or the new parameters are not finite.
    """
    first, acting, fading = items[0], update.regularization, update.fading
    rendering = replace(update.rendering, opacity_factors=acting.factors)
    whole = acting.penalty or acting.gradient or update.requested or first.beside
    if len(items) == 1 and not whole and fading.uniform:
        loss, gradient = screen_gradient(
            params, first, update.place(first), rendering, update.absolute
        )
        losses = [loss]
        broken, means2d = optimizer.step_from(gradient, update.rates, fading.decay)
        stats = step_stats(first, means2d, gradient.radii, rendering, gradient.absolute)
    else:
        gradients: Gradients
        losses, gradients, stats = _summed(params, items, update, rendering, update.absolute)
        if acting.gradient is not None:

            def elsewhere(other: Gaussians) -> Gradients:
                return _summed(other.leaves(), items, update, rendering)[1]

            gradients = acting.gradient(gradients, elsewhere)
        decay = fading.decay if fading.uniform else 1.0
        broken = optimizer.step(params, gradients, update.rates, decay)
        if not fading.uniform:
            fade(params, gradients["opacity_logits"], fading)
    if broken:
        raise diverged(broken, update.place(first), params.detach(), optimizer.state())
    return losses, stats


def substep(
    params: Gaussians,
    optimizer: Optimizer,
    loss: Tensor,
    names: Sequence[str],
    step: int,
    rates: Mapping[str, float],
) -> None:
    """Take a step of the optimizer down a regularizer's `loss`, for the tensors `names` alone.

    Raises:
        Diverged: the loss or the new parameters are not finite.
    """
    where = f"a regularizer's own update in training step {step}"
    check_loss(float(loss.detach()), where, params)
    tensors = dict(params.items())
    gradients = torch.autograd.grad(loss, [tensors[name] for name in names], allow_unused=True)
    broken = optimizer.step(params, dict(zip(names, gradients, strict=True)), rates)
    if broken:
        raise diverged(broken, where, params.detach(), optimizer.state())


def fade(params: Gaussians, in_logits: Tensor, fading: Fading) -> None:
    """Multiply every opacity in place by 1 - (1 - decay) exp(-spare g / mean g), g the size of the
    loss's gradient in it: what the photos need fades less.

    Args:
        params: the Gaussians.
        in_logits: [N], the gradient in the logits.

    Source: StereoGS (2026), relative opacity decay, with spare = 0.5.
    """
    with torch.no_grad():
        logits = params.opacity_logits
        opacities = portable.sigmoid(logits.cpu().numpy())
        size = np.abs(in_logits.cpu().numpy()) / np.maximum(opacities * (1 - opacities), 1e-12)
        relative = size / max(float(size.mean()), 1e-30)
        factors = 1 - (1 - fading.decay) * portable.exp(-fading.spare * relative)
        finite = factors < 1  # an opacity of 1 has no logit
        faded = portable.logit(np.where(finite, np.maximum(opacities * factors, TINY), 0.5))
        lower = torch.from_numpy(np.maximum(faded, LOWEST_LOGIT)).to(logits)
        logits.copy_(torch.where(torch.from_numpy(finite).to(logits.device), lower, logits))


def _summed(
    params: Gaussians,
    items: Sequence[Item],
    update: Update,
    rendering: Rendering,
    absolute: bool = False,
) -> tuple[list[float], dict[str, Tensor], StepStats]:
    """The loss on each view, the gradient of their sum by parameter, the stats of the first."""
    acting = update.regularization
    penalty = None if acting.penalty is None else acting.penalty(params)
    first, *others = items
    loss, gradients, stats = view_gradient(
        params, first, update.place(first), rendering, penalty, absolute
    )
    losses = [loss]
    if update.requested:
        requested = {name: gradients[name].clone() for name in update.requested}
        stats = replace(stats, gradients=requested)
    for item in others:
        loss, more, _ = view_gradient(params, item, update.place(item), rendering, penalty)
        losses.append(loss)
        for name, gradient in more.items():
            gradients[name].add_(gradient)
    return losses, gradients, stats
