"""`reg=occlusion`: the space right in front of the cameras should be transparent.

FreeNeRF (Yang et al. 2023, section 3.4): the mean density of the first samples of every ray. For
Gaussians, it is the mean opacity of those within `depth` near bounds of a training camera that sees
them. Where photos overlap too little to place near objects, these become a wall before a lens.
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
    """depth: how far from the camera a Gaussian is too near, in near bounds."""

    defaults: ClassVar[dict[str, float]] = {"weight": 0.01}

    depth: float = 0.7

    def __post_init__(self) -> None:
        self.check("depth", 0 < self.depth <= 10, "a number in (0, 10]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean opacity of the Gaussians near to the view's camera and in its image."""
        from framework.compute.tensors import sigmoid
        from framework.geometry import project

        if view.pseudo:  # no photo was taken there, so nearness is no artefact
            return None
        _, z = project(ctx.gaussians.means.detach(), view.camera)
        near = (render.radii > 0) & (z < self.depth * ctx.near)
        ctx.log(f"{self.name}_near", float(near.sum()))
        if not near.any():
            return None
        return sigmoid(ctx.gaussians.opacity_logits[near]).mean()
