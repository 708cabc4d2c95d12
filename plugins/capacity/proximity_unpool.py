"""`capacity=proximity_unpool`: add Gaussians between neighbours that are far apart.

FSGS (Zhu et al. 2024, section 3.2 and its code). A large Gaussian whose nearest three others are at
a mean squared distance above a threshold gets a new Gaussian in the middle to each. It has the
opacity and scale of the neighbour, no rotation, and is grey. Thresholds of distance and scale are
in scene extents. Those of the code are 5 (of a squared distance, so in mixed units) and 1, and
rarely reached. Combine it with another capacity, as `capacity=[adc,proximity_unpool]`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register
from framework.toolbox.neighbours import nearest_others

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

NEIGHBOURS = 3


@register("capacity", "proximity_unpool")
@dataclass(frozen=True)
class ProximityUnpool(Capacity):
    """Adds Gaussians where there are few."""

    title: ClassVar[str] = "Proximity unpooling"
    paper: ClassVar[str] = "fsgs"

    defaults: ClassVar[dict[str, float]] = {"start": 0.05, "stop": 0.2}

    far: float = 0.1  # least root mean squared distance to the nearest three, in scene extents
    large: float = 0.02  # least standard deviation of such a Gaussian, in scene extents
    every: float = 0.01  # share of the training between two rounds
    at_most: float = 0.1  # largest share of the Gaussians that a round adds

    def __post_init__(self) -> None:
        self.check("far", 0 < self.far < 1e6, "a number in (0, 1e6)")
        self.check("large", 0 <= self.large < 1e6, "a number in [0, 1e6)")
        self.check("every", 0 < self.every <= 1, "a share in (0, 1]")
        self.check("at_most", 0 < self.at_most <= 10, "a number in (0, 10]")

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        from framework.compute.tensors import exp, root

        if not ctx.due(self.every) or len(ctx.gaussians) <= NEIGHBOURS:
            return None, state
        gaussians = ctx.gaussians
        distances, rows = nearest_others(gaussians.means, NEIGHBOURS)
        apart = root(distances.square().mean(1))
        room = apart > self.far * ctx.extent
        room &= exp(gaussians.log_scales.max(1).values) > self.large * ctx.extent
        chosen = room.nonzero()[:, 0]
        most = max(1, int(self.at_most * len(gaussians)) // NEIGHBOURS)
        chosen = chosen[apart[chosen].argsort(descending=True, stable=True)[:most]]
        ctx.log(f"{self.name}_added", float(NEIGHBOURS * len(chosen)))
        if len(chosen) == 0:
            return None, state
        return Edits(append=between(gaussians, chosen, rows[chosen])), state


def between(gaussians: Gaussians, chosen: Tensor, neighbours: Tensor) -> Gaussians:
    """Make n k Gaussians in the middle between those of rows `chosen` [n] and their `neighbours`
    [n, k].

    They have the neighbour's scales and opacity, no rotation, grey colour, and SH bands.
    """
    import torch

    rows = neighbours.reshape(-1)
    means = (gaussians.means[chosen][:, None] + gaussians.means[neighbours]) / 2
    quats = torch.zeros(len(rows), 4)
    quats[:, 0] = 1
    return type(gaussians)(
        means=means.reshape(-1, 3).contiguous(),
        quats=quats,
        log_scales=gaussians.log_scales[rows].clone(),
        opacity_logits=gaussians.opacity_logits[rows].clone(),
        sh0=torch.zeros(len(rows), 1, 3),
        shN=torch.zeros(len(rows), gaussians.shN.shape[1], 3),
    )
