"""`augment=full_set`: a pseudo view warped from all training views, at any distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.warping import WarpingAugmenter

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "full_set")
@dataclass(frozen=True)
class FullSet(WarpingAugmenter):
    """Every training view is a support."""

    title: ClassVar[str] = "Full set"
    paper: ClassVar[str] = "safi_uar"

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        return list(range(len(ctx.views))), selection
