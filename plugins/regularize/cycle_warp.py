"""`reg=cycle_warp`: a render from an unseen camera, warped back, should match the photo.

GeoAug (2022) renders from a random camera and warps the result onto the photo by its depth, as a
loss. ICO-GS (2026) counts only consistent pixels: a point of the photo, at the unseen camera's
depth where it lands, must return to within a share of the largest depth (0.01). Here the camera
lies between training cameras, with L1 on consistent pixels, in the last sixth of the training as in
ICO-GS. `reg=binocular` is the special case of a shifted camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import seen_through, unseen_camera

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "cycle_warp")
@dataclass(frozen=True)
class CycleWarp(Regularizer):
    """Options of `reg=cycle_warp`.

    Attributes:
        tolerance: largest depth difference on return, as a share of the photo's largest depth.
    """

    title: ClassVar[str] = "Cycle warp"
    paper: ClassVar[str] = "icogs"

    defaults: ClassVar[dict[str, float]] = {"start": 0.833}

    tolerance: float = 0.01

    def __post_init__(self) -> None:
        self.check("tolerance", 0 < self.tolerance <= 1, "a share in (0, 1]")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean absolute difference over pixels and channels of what returns."""
        import torch

        if view.pseudo:
            return None
        camera = unseen_camera(ctx, ctx.rng("camera"), view.camera)
        other = ctx.render(camera, ctx.gaussians, background=ctx.behind)
        depth = render.expected_depth
        seen = torch.cat([other.rgb, other.expected_depth[None]])
        warped, valid, there = seen_through(seen, depth, view.camera, camera)
        returns = (warped[3] - there).abs() <= self.tolerance * depth.max()
        valid = valid & returns.detach()
        if view.mask is not None:
            valid = valid & (view.mask > 0.5)
        ctx.log(f"{self.name}_share", float(valid.float().mean()))
        if not valid.any():
            return None
        return ((warped[:3] - view.image).abs() * valid).sum() / (3 * valid.sum())
