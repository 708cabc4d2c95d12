"""`rasterizer=numba`: compiled kernels for the CPU; same seed, same bits, on any threads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.backends.contract import Rasterizer, RenderGradient

if TYPE_CHECKING:
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import Camera, Gaussians, Render


@dataclass(frozen=True)
class Numba(Rasterizer):
    """`framework.kernels` and `framework.fisher`, as they are."""

    name: ClassVar[str] = "numba"
    fused: ClassVar[bool] = True
    single_pixels: ClassVar[bool] = True

    def render(self, gaussians: Gaussians, camera: Camera, **how: Any) -> Render:
        from framework.kernels import rasterize

        return rasterize(gaussians, camera, **how)

    def render_gradient(
        self,
        gaussians: Gaussians,
        camera: Camera,
        image_gradient: Callable[[Any], Any],
        **how: Any,
    ) -> RenderGradient:
        from framework.kernels import render_gradient

        return render_gradient(gaussians, camera, image_gradient, **how)

    def fisher(self, gaussians: Gaussians, camera: Camera, **how: Any) -> FisherInformation:
        from framework.fisher.information import fisher_information

        return fisher_information(gaussians, camera, **how)

    def target(self, image: Tensor, mask: Tensor | None) -> Any:
        from framework.kernels.losses import Target

        return Target.of(image, mask)

    def loss(self, rgb: Tensor, target: Any, ssim_weight: float) -> Tensor:
        from framework.kernels.losses import photometric_loss

        return photometric_loss(rgb, target, ssim_weight)

    def loss_gradient(
        self, rgb: Any, target: Any, ssim_weight: float, weight: float
    ) -> tuple[float, Any]:
        from framework.kernels.losses import photometric_gradient

        return photometric_gradient(rgb, target, ssim_weight, weight)

    def roughness_gradient(self, alpha: Any, depth: Any, weights: Tensor) -> tuple[Any, Any]:
        import numpy as np

        from framework.kernels.roughness import roughness_gradient

        return roughness_gradient(np.asarray(alpha), np.asarray(depth), weights.numpy())

    def binocular_gradient(
        self, alpha: Any, depth: Any, beside: Render, target: Any, *numbers: float
    ) -> tuple[Any, Any, Any]:
        import numpy as np

        from framework.kernels.binocular import binocular_gradient

        seen = tuple(t.detach().numpy() for t in (beside.rgb, beside.alpha, beside.depth))
        of_photo = np.asarray(alpha), np.asarray(depth)
        return binocular_gradient(*of_photo, seen, target.image, target.mask, *numbers)
