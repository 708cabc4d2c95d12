"""`reg=render_consistency`: a render with dropped Gaussians should match the full render.

DropoutGS (Xu et al. 2025, arXiv 2504.09491, random dropout regularization). The render of all
Gaussians is compared with the photo. Another is made in which each Gaussian is left out with
probability p, and both renders are compared by (1 - w) L1 + w (1 - SSIM), with gradients into both.
The text reports that comparing the second with the photo works worse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import difference

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "render_consistency")
@dataclass(frozen=True)
class RenderConsistency(Regularizer):
    """Options of `reg=render_consistency`.

    Attributes:
        p: share of the Gaussians that the second render drops.
        compensate: multiply what it keeps by 1 / (1 - p).
        ssim_weight: w.
    """

    title: ClassVar[str] = "Render consistency"
    paper: ClassVar[str] = "dropoutgs"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.2}

    p: float = 0.4
    compensate: bool = False
    ssim_weight: float = 0.2

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p < 1, "a number in (0, 1)")
        self.check("ssim_weight", 0 <= self.ssim_weight <= 1, "a number in [0, 1]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        import torch

        if view.pseudo:
            return None
        kept = ctx.rng("dropped").random(len(ctx.gaussians)) >= self.p
        ctx.log(f"{self.name}_left_out", 1 - float(kept.mean()))
        factors = torch.from_numpy(kept).float() / ((1 - self.p) if self.compensate else 1.0)
        other = ctx.render(
            view.camera, ctx.gaussians, opacity_factors=factors, background=ctx.behind
        )
        return difference(render.rgb, other.rgb, self.ssim_weight)
