"""`augment=euclidean`: the support views of a pseudo view chosen by distance.

As SAFI, with the distance of the camera centres d_k in the place of the information I_k: all views
with d_k <= eta min d are warped. What it lacks beside SAFI is any notion of what the cameras see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.methods.warping import ThresholdAugmenter, center_distances
from framework.plugin import StepContext, register

if TYPE_CHECKING:
    from framework.types import Camera


@register("augment", "euclidean")
@dataclass(frozen=True)
class Euclidean(ThresholdAugmenter):
    """eta: a view supports if its camera centre is at most eta x the smallest distance away."""

    title: ClassVar[str] = "Euclidean"
    paper: ClassVar[str] = "safi_uar"

    def scores(self, ctx: StepContext, selection: Any, camera: Camera) -> tuple[list[float], Any]:
        return center_distances(ctx.views, camera), selection
