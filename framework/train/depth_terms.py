"""The terms of the loss on a view that ask for its depth: how rough it is where the photo is smooth
(`smoothness`), and what a camera beside it sees (`binocular`)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from framework.backends import Rasterizer
from framework.train.binocular import Beside
from framework.train.epoch import Item
from framework.types import Gaussians


class _Pulled(torch.autograd.Function):
    """A scalar whose gradient in an image [3, H, W] is the given one of that shape. Given to
    `torch.autograd.grad` itself, it would make torch import sympy."""

    @staticmethod
    def forward(ctx: Any, image: Tensor, gradient: Tensor) -> Tensor:
        ctx.gradient = gradient
        return image.new_zeros(())

    @staticmethod
    def backward(ctx: Any, _: Tensor) -> tuple[Tensor, None]:  # type: ignore[override]
        return ctx.gradient, None


class DepthTerms:
    """Their gradient, on one view of `params`. rendered: how, see `Rasterizer.render`.

    elsewhere: of the render from beside, the gradient in every parameter, by name; empty until
    asked, and where there is none.
    """

    def __init__(
        self, params: Gaussians, item: Item, rasterizer: Rasterizer, **rendered: Any
    ) -> None:
        self._params, self._item = params, item
        self._rasterizer, self._rendered = rasterizer, rendered
        self.elsewhere: dict[str, Tensor] = {}

    @property
    def any(self) -> bool:
        return self._item.smoothing is not None or self._item.beside is not None

    def __call__(self, alpha: Any, depth: Any) -> tuple[Any, Any]:
        """The gradient in alpha and depth [H, W] of the view's render."""
        item, found = self._item, []
        if item.smoothing is not None:
            found.append(self._rasterizer.roughness_gradient(alpha, depth, item.smoothing))
        if item.beside is not None:
            found.append(self._from_beside(item.beside, alpha, depth))
        (in_alpha, in_depth), *others = found
        for more_alpha, more_depth in others:
            in_alpha += more_alpha
            in_depth += more_depth
        return in_alpha, in_depth

    def _from_beside(self, beside: Beside, alpha: Any, depth: Any) -> tuple[Any, Any]:
        tensors = dict(self._params.items())
        render = self._rasterizer.render(self._params, beside.camera, **self._rendered)
        in_alpha, in_depth, in_rgb = self._rasterizer.binocular_gradient(
            alpha, depth, render, self._item.target, beside.moves, beside.tolerance, beside.weight
        )
        pulled = _Pulled.apply(render.rgb, torch.as_tensor(in_rgb))
        found = torch.autograd.grad(pulled, list(tensors.values()), materialize_grads=True)
        self.elsewhere = dict(zip(tensors, found, strict=True))
        return in_alpha, in_depth

    def added(self, gradients: dict[str, Tensor]) -> dict[str, Tensor]:
        """`gradients` of the view's own render, with those of the other added in place."""
        for name, gradient in self.elsewhere.items():
            gradients[name].add_(gradient)
        return gradients
