"""`rasterizer=numba`: compiled kernels for the CPU; same seed, same bits, on any threads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.backends.contract import Rasterizer, RenderGradient

if TYPE_CHECKING:
    from framework.types import Camera, Gaussians, Render


@dataclass(frozen=True)
class Numba(Rasterizer):
    """`framework.kernels`, as they are."""

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

    def losses(self) -> Any:
        from framework.backends import numba_loss

        return numba_loss
