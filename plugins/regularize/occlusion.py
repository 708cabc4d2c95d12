"""`reg=occlusion`: penalize opacity close to the training cameras.

FreeNeRF (Yang et al. 2023, section 3.4) penalizes the density of the first samples of every ray.
Here it is the mean opacity of Gaussians within `depth` near bounds of a training camera that sees
them. Where photos overlap too little to place near content, it ends up right in front of a
camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "occlusion")
@dataclass(frozen=True)
class Occlusion(Regularizer):
    """Options of `reg=occlusion`.

    Attributes:
        depth: distance below which a Gaussian is too near, in near bounds.
    """

    title: ClassVar[str] = "Occlusion"
    paper: ClassVar[str] = "freenerf"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.01}

    depth: float = 0.7

    def __post_init__(self) -> None:
        self.check("depth", 0 < self.depth <= 10, "a number in (0, 10]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean opacity of the Gaussians near to the view's camera and in its image."""
        from framework.compute.tensors import sigmoid
        from framework.geometry import project

        if view.pseudo:  # no photo was taken there, so nothing is too near
            return None
        _, z = project(ctx.gaussians.means.detach(), view.camera)
        near = (render.radii > 0) & (z < self.depth * ctx.near)
        ctx.log(f"{self.name}_near", float(near.sum()))
        if not near.any():
            return None
        return sigmoid(ctx.gaussians.opacity_logits[near]).mean()
