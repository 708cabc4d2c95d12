"""`reg=co_register`: two trainings of one scene should agree in views without photos.

CoR-GS (Zhang et al. 2024, arXiv 2405.12110, section 3.3): a second field is trained in parallel. At
a camera between training cameras each is compared with the other's render, (1 - w) L1 +
w (1 - SSIM), without a gradient into the other. Only the first is evaluated. Takes more than twice
the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, Variant, register
from framework.toolbox.elsewhere import unseen_camera

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "co_register")
@dataclass(frozen=True)
class CoRegister(Regularizer):
    """Options of `reg=co_register`.

    Attributes:
        ssim_weight: w.
        second_drawn: initialize the second field with a different draw of Gaussians. As in CoR-GS,
            it otherwise starts with the same ones and random splits make them differ; with a
            capacity that draws nothing (`evidence`), both would stay identical.
    """

    title: ClassVar[str] = "Co-regularization"
    paper: ClassVar[str] = "corgs"
    variants: ClassVar[dict[str, Variant]] = {
        "co_register_drawn": Variant("second_drawn", True, "Co-regularization (2 draws)", "corgs"),
    }

    second_field: ClassVar[bool] = True
    defaults: ClassVar[dict[str, float]] = {"start": 0.05}

    ssim_weight: float = 0.2
    second_drawn: bool = False

    def __post_init__(self) -> None:
        self.check("ssim_weight", 0 <= self.ssim_weight <= 1, "a number in [0, 1]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        from framework.kernels.losses import Target, photometric_loss

        if ctx.other is None or view.pseudo:
            return None
        camera = unseen_camera(ctx, ctx.rng("camera"), view.camera)  # each field its own
        seen, other = (
            ctx.render(camera, gaussians, background=ctx.behind)
            for gaussians in (ctx.gaussians, ctx.other)
        )
        return photometric_loss(seen.rgb, Target.of(other.rgb), self.ssim_weight)
