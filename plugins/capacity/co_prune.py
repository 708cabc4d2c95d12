"""`capacity=co_prune`: prune Gaussians without a close neighbour in a second training.

CoR-GS (Zhang et al. 2024, section 3.2): every 500 of 10,000 steps, where the nearest Gaussian of
the other field is farther away than tau. Its tau is in scene units (5 for LLFF). Here it is in
scene extents, so that it means the same for a scene of any size. Combine it with another capacity,
as `capacity=[adc,co_prune]`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register
from framework.toolbox.neighbours import nearest_distance


@register("capacity", "co_prune")
@dataclass(frozen=True)
class CoPrune(Capacity):
    """Options of `capacity=co_prune`.

    Attributes:
        distance: largest distance to the nearest Gaussian of the other field, in scene extents.
        every: share of the training between two rounds.
    """

    title: ClassVar[str] = "Co-pruning"
    paper: ClassVar[str] = "corgs"

    second_field: ClassVar[bool] = True
    defaults: ClassVar[dict[str, float]] = {"start": 0.05, "stop": 0.96}

    distance: float = 0.5
    every: float = 0.05

    def __post_init__(self) -> None:
        self.check("distance", 0 < self.distance < 1e6, "a number in (0, 1e6)")
        self.check("every", 0 < self.every <= 1, "a share in (0, 1]")

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        if ctx.other is None or not ctx.due(self.every):
            return None, state
        far = nearest_distance(ctx.gaussians.means, ctx.other.means)
        keep = far <= self.distance * ctx.extent
        ctx.log(f"{self.name}_removed", float((~keep).sum()))
        return (None if keep.all() or not keep.any() else Edits(keep=keep)), state
