"""`augment=mvs_warp`: a pseudo view warped from one random training view.

MVPGS (Xu et al. 2024) warps one photo by its multi-view stereo depth into a nearby camera. There
the pseudo view replaces the photo in every third step; here it joins steps like any pseudo view
(`trainer.pseudo_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.warping import WarpingAugmenter

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "mvs_warp")
@dataclass(frozen=True)
class MvsWarp(WarpingAugmenter):
    """No options except those that every warping method has."""

    title: ClassVar[str] = "MVPGS warp"
    paper: ClassVar[str] = "mvpgs"

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        """One index, drawn evenly."""
        return [int(ctx.rng("source").integers(len(ctx.views)))], selection
