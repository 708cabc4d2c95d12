"""`augment=dba`: depth-based augmentation, a pseudo view warped from the closest training view.

The single-source warp of the sparse-view literature and SAFI's main rival: the same cameras and the
same warp, but one support, the view whose camera centre is nearest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.warping import WarpingAugmenter, center_distances

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "dba")
@dataclass(frozen=True)
class Dba(WarpingAugmenter):
    """One support view; the first of equally close ones."""

    title: ClassVar[str] = "DBA"
    paper: ClassVar[str] = "safi_uar"

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        distances = center_distances(ctx.views, camera)
        return [distances.index(min(distances))], selection
