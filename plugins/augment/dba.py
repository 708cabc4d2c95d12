"""`augment=dba`: depth-based augmentation, a pseudo view warped from the one closest training view.

The single-source warp that the sparse-view literature uses, and what SAFI is measured against: the
same cameras, the same warp, but one support, the view whose camera centre is nearest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.methods.warping import WarpingAugmenter, center_distances
from framework.plugin import StepContext, register

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "dba")
@dataclass(frozen=True)
class Dba(WarpingAugmenter):
    """One support. Of equally close views the first one is taken."""

    title: ClassVar[str] = "DBA"
    paper: ClassVar[str] = "safi_uar"

    def select(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[int], Any]:
        distances = center_distances(ctx.views, camera)
        return [distances.index(min(distances))], selection
