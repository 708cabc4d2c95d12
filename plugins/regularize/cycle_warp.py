"""`reg=cycle_warp`: a render from an unseen camera, seen back from a photo, should be the photo.

GeoAug (2022) renders at a random camera and warps that back onto the photo by its depth. It is a
loss and not a pseudo view; `reg=binocular` is its case of a camera to the side. ICO-GS (2026)
counts only what returns: a point of the photo, moved by the unseen camera's depth, has to return to
within a share of the largest depth (0.01). Both are combined here: a camera between training
cameras, L1 on what passes, in the last sixth of the training as in ICO-GS.
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
    """tolerance: largest difference of depth on return, as a share of the photo's largest depth."""

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
