"""`augment=euclidean`: a pseudo view warped from the views whose cameras are near.

Like SAFI, with the distance d_k of the camera centres instead of the information I_k: all views
with d_k <= eta min d are warped. A control for SAFI that ignores what the cameras see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.warping import ThresholdAugmenter, center_distances

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "euclidean")
@dataclass(frozen=True)
class Euclidean(ThresholdAugmenter):
    """eta: a view is a support if its camera centre is at most eta x the smallest distance away."""

    title: ClassVar[str] = "Euclidean"
    paper: ClassVar[str] = "safi_uar"

    def scores(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[float], Any]:
        return center_distances(ctx.views, camera), selection
