"""The common part of rasterizers whose gradients are autograd's: loss and gradient in torch, on any
device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framework.backends.contract import DepthGradient, Rasterizer, RenderGradient

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians


@dataclass(frozen=True)
class TakenGradient:
    """A gradient that is whole already; see `contract.RenderGradient`.

    Attributes:
        tensors: by name.
        means2d: [N, 2] in pixels.
    """

    gaussians: Gaussians
    radii: Tensor
    tensors: dict[str, Tensor]
    means2d: Tensor
    absolute: Tensor | None = None  # autograd sums over the pixels

    def pull_back(self) -> tuple[dict[str, Tensor], Tensor]:
        return self.tensors, self.means2d

    def drop(self) -> None:
        """Do nothing: there are no buffers."""


@dataclass(frozen=True)
class ByAutograd(Rasterizer):
    """A rasterizer that only has to `render`."""

    def render_gradient(
        self,
        gaussians: Gaussians,
        camera: Camera,
        image_gradient: Callable[[Any], Any],
        *,
        absolute: bool = False,
        depth_gradient: DepthGradient | None = None,
        **how: Any,
    ) -> RenderGradient:
        import torch

        placed = gaussians.to(self.device)
        leaves = placed.map(lambda t: t.detach().requires_grad_())
        offset = placed.means.new_zeros(len(placed), 2, requires_grad=True)
        deep = depth_gradient is not None
        render = self.render(leaves, camera, means2d_offset=offset, depth=deep, **how)
        tensors = dict(leaves.items())
        outputs, pulls = [render.rgb], [image_gradient(render.rgb.detach())]
        if depth_gradient is not None:
            outputs += [render.alpha, render.depth]
            pulls += depth_gradient(render.alpha.detach(), render.depth.detach())
        *gradients, means2d = torch.autograd.grad(
            outputs,
            [*tensors.values(), offset],
            pulls,
            materialize_grads=True,  # of an empty image
        )
        return TakenGradient(
            gaussians, render.radii, dict(zip(tensors, gradients, strict=True)), means2d
        )

    def losses(self) -> Any:
        from framework.backends import torch_loss

        return torch_loss
