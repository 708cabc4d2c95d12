"""`augment=mvs_warp`: a pseudo view warped from one training view, drawn at random.

MVPGS (Xu et al. 2024): one photo, whichever, is warped by its multi-view stereo depth into a camera
nearby; depth is what `depth=` gives. Its pseudo view takes the place of the photo in every third
step; here it joins steps as every pseudo view does (`trainer.pseudo_steps`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.methods.warping import WarpingAugmenter
from framework.plugin import StepContext, register

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "mvs_warp")
@dataclass(frozen=True)
class MvsWarp(WarpingAugmenter):
    """Options: those of every warping method."""

    title: ClassVar[str] = "MVPGS warp"
    paper: ClassVar[str] = "mvpgs"

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        """One index, drawn evenly."""
        return [int(ctx.rng("source").integers(len(ctx.views)))], selection
