"""The contract of rasterizers, which render Gaussians and take gradients.

The trainer, the plugins' context and the evaluation use this contract and no particular rasterizer.
Importing it loads neither torch nor numba, as `--help` lists the choices.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from framework.records.provenance import BITS

if TYPE_CHECKING:
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import Camera, Gaussians, Render

NOT_KEPT = "not kept by this rasterizer"
DepthGradient = Callable[[Any, Any], tuple[Any, Any]]


class RenderGradient(Protocol):
    """The gradient of a loss on one render.

    Attributes:
        radii: [N] in pixels, 0 = culled.
        absolute: [N, 2], absolute gradient in the projected means, if requested.
    """

    @property
    def gaussians(self) -> Gaussians: ...

    @property
    def radii(self) -> Tensor: ...

    @property
    def absolute(self) -> Tensor | None: ...

    def pull_back(self) -> tuple[dict[str, Tensor], Tensor]:
        """Return the gradients in the tensors of `gaussians` by name, and in the projected means
        [N, 2] in pixels. May be called once."""

    def drop(self) -> None:
        """Release the buffers instead of calling `pull_back`."""


class Rasterizer(ABC):
    """A rasterizer: a frozen dataclass whose fields are options of `rasterizer=NAME`.

    Gaussians may be on any device. Results are on `device`, Fisher information on the CPU.

    Attributes:
        keeps_bits: whether the same seed gives the same bits.
        fused: gradients are `framework.kernels.ScreenGradient`s for Adam's kernel.
        single_pixels: whether `render_gradient` can give absolute gradients.
    """

    name: ClassVar[str]
    keeps_bits: ClassVar[bool] = True
    fused: ClassVar[bool] = False
    single_pixels: ClassVar[bool] = False

    @property
    def device(self) -> str:
        """Return the torch device of a training's parameters, moments and targets."""
        return "cpu"

    def ready(self) -> None:  # noqa: B027 - most are ready anywhere
        """Raise UserError, in one line, where this machine cannot draw so."""

    def facts(self) -> dict[str, Any]:
        """Return facts for a run's provenance; none if the rasterizer is reproducible."""
        return {} if self.keeps_bits else {BITS: NOT_KEPT}

    @abstractmethod
    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        *,
        background: Tensor | None = None,
        sh_degree: int | None = None,
        opacity_factors: Tensor | None = None,
        means2d_offset: Tensor | None = None,
        near: float = 0.01,
        depth: bool = True,
    ) -> Render:
        """What `camera` sees, as `framework.kernels.rasterize`; differentiable in all tensors but
        the background."""

    @abstractmethod
    def render_gradient(
        self,
        gaussians: Gaussians,
        camera: Camera,
        image_gradient: Callable[[Any], Any],
        *,
        background: Tensor | None = None,
        sh_degree: int | None = None,
        opacity_factors: Tensor | None = None,
        near: float = 0.01,
        absolute: bool = False,
        depth_gradient: DepthGradient | None = None,
    ) -> RenderGradient:
        """Render, and take the gradient of a loss of the colours.

        Args:
            image_gradient: gets rgb [3, H, W] and returns the loss's gradient in it.
            absolute: also sum absolute gradients; only if `single_pixels`.
            depth_gradient: gets alpha and depth [H, W] and returns gradients in them, which are
                added.
        """

    def fisher(self, gaussians: Gaussians, camera: Camera, **options: Any) -> FisherInformation:
        """Information of the camera's image on each Gaussian, by the kernels on the CPU; see
        `framework.fisher.information`, which also has the options."""
        from framework.fisher.information import fisher_information

        return fisher_information(gaussians.to("cpu"), camera, **options)

    @abstractmethod
    def losses(self) -> Any:
        """The module with the losses of this rasterizer's renders: the functions of
        `framework.backends.torch_loss`, on images as `render` and `render_gradient` have them."""
