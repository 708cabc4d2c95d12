"""The training loss on one view and its gradient in every parameter."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer, RenderGradient
from framework.plugin import StepStats
from framework.train.depth_priors import Beside
from framework.train.epoch import Item
from framework.train.guard import check_loss
from framework.types import Gaussians, Render, View

Penalty = Callable[[View, Render], Tensor | float]
ViewGradient = tuple[float, dict[str, Tensor], StepStats]


@dataclass(frozen=True)
class Rendering:
    """How an update renders views and measures the photometric loss.

    Attributes:
        background, sh_degree, near, opacity_factors: see `Rasterizer.render`.
        ssim_weight: w of (1 - w) L1 + w (1 - SSIM).
    """

    background: Tensor | None = None
    sh_degree: int | None = None
    near: float = 0.01
    opacity_factors: Tensor | None = None
    ssim_weight: float = 0.2
    rasterizer: Rasterizer = NUMBA

    def options(self) -> dict[str, Any]:
        """The options of `Rasterizer.render`."""
        names = ("background", "sh_degree", "near", "opacity_factors")
        return {name: getattr(self, name) for name in names}


class _Weighted(torch.autograd.Function):
    """A scalar whose gradient in an image [3, H, W] is a given one. As `grad_outputs` of
    `torch.autograd.grad` that gradient would make torch import sympy."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, gradient: Tensor) -> Tensor:
        ctx.gradient = gradient
        return image.new_zeros(())

    @staticmethod
    def backward(ctx: Any, _: Tensor) -> tuple[Tensor, None]:  # type: ignore[override]
        return ctx.gradient, None


class DepthTerms:
    """The gradient of the depth terms on one view.

    Args:
        params: the Gaussians.
        item: the view.
        rasterizer: renders the second camera.
        options: of `Rasterizer.render`.

    Attributes:
        elsewhere: gradient of the second camera's render by parameter name, empty without one.
    """

    def __init__(
        self, params: Gaussians, item: Item, rasterizer: Rasterizer, options: Mapping[str, Any]
    ) -> None:
        self._params, self._item = params, item
        self._rasterizer, self._options, self._losses = rasterizer, options, rasterizer.losses()
        self.elsewhere: dict[str, Tensor] = {}

    @property
    def any(self) -> bool:
        return self._item.smoothing is not None or self._item.beside is not None

    def __call__(self, alpha: Any, depth: Any) -> tuple[Any, Any]:
        """Return the gradient in alpha and depth [H, W] of the view's render."""
        item, gradients = self._item, []
        if item.smoothing is not None:
            gradients.append(self._losses.roughness_gradient(alpha, depth, item.smoothing))
        if item.beside is not None:
            gradients.append(self._from_beside(item.beside, alpha, depth))
        (in_alpha, in_depth), *others = gradients
        for more_alpha, more_depth in others:
            in_alpha += more_alpha
            in_depth += more_depth
        return in_alpha, in_depth

    def _from_beside(self, beside: Beside, alpha: Any, depth: Any) -> tuple[Any, Any]:
        tensors = dict(self._params.items())
        render = self._rasterizer.render(self._params, beside.camera, **self._options)
        in_alpha, in_depth, in_rgb = self._losses.binocular_gradient(
            alpha, depth, render, self._item.target, beside.moves, beside.tolerance, beside.weight
        )
        weighted = _Weighted.apply(render.rgb, torch.as_tensor(in_rgb))
        gradients = torch.autograd.grad(weighted, list(tensors.values()), materialize_grads=True)
        self.elsewhere = dict(zip(tensors, gradients, strict=True))
        return in_alpha, in_depth

    def added(self, gradients: dict[str, Tensor]) -> dict[str, Tensor]:
        """Add the gradient of the second camera's render to `gradients` in place."""
        for name, gradient in self.elsewhere.items():
            gradients[name].add_(gradient)
        return gradients


def screen_gradient(
    params: Gaussians,
    item: Item,
    where: str,
    rendering: Rendering,
    absolute: bool = False,
    terms: DepthTerms | None = None,
) -> tuple[float, RenderGradient]:
    """Return the photometric loss on a view, and the gradient on the screen.

    The gradient includes the depth terms, which the returned loss does not.

    Args:
        params: the Gaussians.
        item: the view.
        where: the place, for messages.
        rendering: how to render.
        absolute: also sum absolute gradients, see `Rasterizer.render_gradient`.
        terms: the depth terms; by default those of the view. The caller adds the gradient that they
            have in another render.

    Raises:
        Diverged: the loss is not finite.
    """
    rasterizer = rendering.rasterizer
    if terms is None:
        terms = DepthTerms(params, item, rasterizer, rendering.options())
    view, loss = item.view, 0.0

    def image_gradient(rgb: Any) -> Any:
        nonlocal loss
        loss, gradient = rasterizer.losses().loss_gradient(
            rgb, item.target, rendering.ssim_weight, view.weight
        )
        check_loss(loss, where, params)
        return gradient

    gradient = rasterizer.render_gradient(
        params,
        view.camera,
        image_gradient,
        absolute=absolute,
        depth_gradient=terms if terms.any else None,
        **rendering.options(),
    )
    return loss, gradient


def view_gradient(
    params: Gaussians,
    item: Item,
    where: str,
    rendering: Rendering,
    penalty: Penalty | None = None,
    absolute: bool = False,
) -> ViewGradient:
    """Return the photometric loss on a view, the gradient by parameter name, and the step's stats.

    Without a penalty the gradient is taken directly; autograd would give the same bits. Autograd
    cannot separate pixels, so with a penalty `absolute` takes another render.

    Args:
        penalty: a differentiable term of the view and its render that is added to the loss.
    """
    if penalty is not None:
        loss, parameters, stats = _by_autograd(params, item, where, rendering, penalty)
        if absolute:
            item = replace(item, smoothing=None, beside=None)  # colours only
            _, gradient = screen_gradient(params, item, where, rendering, absolute=True)
            gradient.drop()
            stats = replace(stats, absolute=gradient.absolute)
        return loss, parameters, stats
    terms = DepthTerms(params, item, rendering.rasterizer, rendering.options())
    loss, gradient = screen_gradient(params, item, where, rendering, absolute, terms)
    parameters, means2d = gradient.pull_back()
    stats = step_stats(item, means2d, gradient.radii, rendering, gradient.absolute)
    return loss, terms.added(parameters), stats


def step_stats(
    item: Item,
    means2d: Tensor,
    radii: Tensor,
    rendering: Rendering,
    absolute: Tensor | None = None,
) -> StepStats:
    """Return the statistics of a view's render and gradient for capacity plugins."""
    return StepStats(
        means2d,
        radii,
        item.view.camera.width,
        item.view.camera.height,
        factors=rendering.opacity_factors,
        view=item.view,
        absolute=absolute,
    )


def _by_autograd(
    params: Gaussians, item: Item, where: str, rendering: Rendering, penalty: Penalty
) -> ViewGradient:
    view, rasterizer = item.view, rendering.rasterizer
    offset = params.means.new_zeros(len(params), 2, requires_grad=True)
    render = rasterizer.render(params, view.camera, means2d_offset=offset, **rendering.options())
    loss = rasterizer.losses().photometric_loss(render.rgb, item.target, rendering.ssim_weight)
    loss = loss * view.weight
    photometric = float(loss.detach())
    check_loss(photometric, where, params)
    loss = loss + penalty(view, render)  # the plugin's call checks that it is finite
    tensors, outputs, weights = dict(params.items()), [loss], [torch.ones_like(loss)]
    terms = DepthTerms(params, item, rasterizer, rendering.options())
    if terms.any:
        outputs += [render.alpha, render.depth]
        weights += map(torch.as_tensor, terms(render.alpha.detach(), render.depth.detach()))
    *gradients, means2d = torch.autograd.grad(
        outputs, [*tensors.values(), offset], weights, materialize_grads=True
    )
    stats = step_stats(item, means2d, render.radii, rendering)
    return photometric, terms.added(dict(zip(tensors, gradients, strict=True))), stats
