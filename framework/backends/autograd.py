"""The common part of rasterizers whose gradients are autograd's: loss, gradient and Fisher
information in torch, on any device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from framework.backends.contract import DepthGradient, Rasterizer, RenderGradient

if TYPE_CHECKING:
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import Camera, Gaussians, Render


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
        """It holds nothing of others."""


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

    def fisher(self, gaussians: Gaussians, camera: Camera, **how: Any) -> FisherInformation:
        from framework.fisher.in_torch import fisher_in_torch

        return fisher_in_torch(gaussians.to(self.device), camera, **how)

    def target(self, image: Tensor, mask: Tensor | None) -> Any:
        from framework.backends.torch_loss import TorchTarget

        return TorchTarget.of(image, mask, self.device)

    def loss(self, rgb: Tensor, target: Any, ssim_weight: float) -> Tensor:
        from framework.backends.torch_loss import photometric_loss

        return photometric_loss(rgb, target, ssim_weight)

    def loss_gradient(
        self, rgb: Any, target: Any, ssim_weight: float, weight: float
    ) -> tuple[float, Any]:
        from framework.backends.torch_loss import loss_gradient

        return loss_gradient(rgb, target, ssim_weight, weight)

    def roughness_gradient(self, alpha: Any, depth: Any, weights: Tensor) -> tuple[Any, Any]:
        from framework.backends.torch_loss import roughness_gradient

        return roughness_gradient(alpha, depth, weights)

    def binocular_gradient(
        self, alpha: Any, depth: Any, beside: Render, target: Any, *numbers: float
    ) -> tuple[Any, Any, Any]:
        from framework.backends.torch_loss import binocular_gradient

        return binocular_gradient(alpha, depth, beside, target, *numbers)
