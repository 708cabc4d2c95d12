"""`capacity=budget`: a fixed number of Gaussians, allocated where they matter most.

The initialisation usually makes more Gaussians than the budget. From `start` to `until` rounds
bring the number to it in equal ratios. Every round drops the Gaussians whose removal changes the
training images least (`fisher.scores.removal_energy`). It splits the share `grow` of the others
with the largest gradient, by default all, so Gaussians move to where they are missing.

With many views few epochs lie between rounds, and splits are judged before they are trained. Below
ten epochs `grow` falls with the square of their number (chosen by experiment, see
`benchmarks/results/capacity.md`). After `until` the number is exact and stays, unless growth by at
most a quarter per round did not reach it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from framework.plugin import StepContext, register
from framework.toolbox.rounds import RoundsCapacity, Selection, TrainingInformation

GROWTH = 1.25  # largest ratio of the numbers after and before a round


@register("capacity", "budget")
@dataclass(frozen=True)
class Budget(RoundsCapacity):
    """Options of `capacity=budget`.

    Attributes:
        gaussians: the number from `until` on; members (`trainer.members`) share it. With `bytes`
            it is the number that fits instead.
    """

    gaussians: int = 5000

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("gaussians", self.gaussians >= 1, "an integer >= 1")

    def shared(self, members: int) -> Budget:
        return replace(super().shared(members), gaussians=max(1, self.gaussians // members))

    def check_span(self, start: float, stop: float) -> None:
        super().check_span(start, stop)
        self.check_limited(start)

    def selected(self, ctx: StepContext, information: TrainingInformation) -> Selection:
        import torch

        from framework.fisher.scores import removal_energy

        n = len(ctx.gaussians)
        wanted = self._wanted(n, self.rounds_left(ctx), self.limit(ctx) or self.gaussians)
        grow = self.grow * self.settled(ctx) ** 2 if self.growing(ctx) else 0.0
        n_kept = min(n, math.ceil(wanted / (1 + grow)))
        energy = removal_energy(information.total.diagonal, ctx.gaussians.opacity_logits)
        keep = torch.zeros(n, dtype=torch.bool)
        keep[energy.argsort(descending=True, stable=True)[:n_kept]] = True
        splits = min(wanted - n_kept, n_kept) if self.rounds_left(ctx) > 0 else 0
        return Selection(keep, splits)

    def _interval(self, ctx: StepContext) -> int:
        """At least about an epoch, with the last round at `until`.

        A round costs two epochs, so with many views rounds would cost more than the training.
        """
        every, views = super()._interval(ctx), len(ctx.views)
        until = max(1, math.floor(self.until * ctx.n_steps))
        return every if every >= views else max(every, until // max(1, until // views))

    def _wanted(self, n: int, rounds_left: int, budget: int) -> int:
        """How many there shall be after this round, of `rounds_left` up to `until`."""
        if n <= budget:
            return min(budget, math.ceil(GROWTH * n))
        if rounds_left <= 1:
            return budget
        return round(n * (budget / n) ** (1 / rounds_left))
