"""`capacity=fisher_prune`: prune the Gaussians to which the images are least sensitive (PUP-3DGS).

Hanson et al. 2025, "PUP 3D-GS: principled uncertainty pruning for 3D Gaussian splatting". The
sensitivity is log det of the 6x6 Fisher block of mean and log-scale, summed over the training
views. The paper prunes 80 % after 30,000 steps, trains 5,000, prunes half of the rest and trains
5,000 more. The defaults are the same shares of a training of any length.

Two things differ from its code. A block that few views leave singular gets a relative prior
(`uncertainty` in `framework.fisher.scores`), as all such Gaussians would tie at minus infinity. And
the views are taken at full resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register

if TYPE_CHECKING:
    from torch import Tensor


@register("capacity", "fisher_prune")
@dataclass(frozen=True)
class FisherPrune(Capacity):
    """Prunes in rounds at the end of the training; the rest is fine-tuning."""

    title: ClassVar[str] = "PUP 3D-GS"
    paper: ClassVar[str] = "pup"

    first: float = 0.8  # share of the Gaussians that the first round prunes
    again: float = 0.5  # share of the rest that every later round prunes
    rounds: int = 2  # number of rounds
    begin: float = 0.75  # share of the training before the first round
    regulariser: float = 1e-4  # prior precision as a share of the median diagonal of the blocks

    def __post_init__(self) -> None:
        self.check("first", 0 <= self.first < 1, "a share in [0, 1)")
        self.check("again", 0 <= self.again < 1, "a share in [0, 1)")
        self.check("rounds", self.rounds >= 1, "an integer >= 1")
        self.check("begin", 0 <= self.begin < 1, "a share in [0, 1)")
        self.check("regulariser", 0 < self.regulariser <= 1e3, "a number in (0, 1000]")

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        """At a round's step, drop the least sensitive; at least one Gaussian stays."""
        steps = self._steps(ctx.n_steps)
        if ctx.step not in steps:
            return None, state
        share = self.first if ctx.step == steps[0] else self.again
        n = len(ctx.gaussians)
        keep = self._most_sensitive(ctx, max(1, n - round(share * n)))
        ctx.log("pruned", float((~keep).sum()))
        return Edits(keep), state

    def _steps(self, n_steps: int) -> list[int]:
        """After which steps a round is due; never after the last."""
        lengths = ((1 - self.begin) * k / self.rounds for k in range(self.rounds))
        last = max(0, n_steps - 2)  # edits come after a step, and what is left trains once more
        return sorted({min(int((self.begin + length) * n_steps), last) for length in lengths})

    def _most_sensitive(self, ctx: StepContext, n: int) -> Tensor:
        """[N] bool: the `n` with the largest log determinant."""
        import torch

        from framework.fisher.scores import uncertainty
        from framework.toolbox.rounds import training_information

        information = training_information(ctx).total
        scores = uncertainty(information.block, information.visible, ctx.extent, self.regulariser)
        keep = torch.zeros(len(ctx.gaussians), dtype=torch.bool)
        keep[scores.argsort(stable=True)[:n]] = True
        return keep
