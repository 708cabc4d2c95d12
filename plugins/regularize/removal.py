"""`reg=removal`: Gaussians are left out at random, and opacities are reduced for evaluation.

The first of two strategies against co-adaptation (Chen et al. 2025, arXiv 2508.12720). A training
render leaves out a constant share p. The evaluated Gaussians are complete, with opacities times
1 - p, so that both absorb as much in expectation. `reg=uniform` with compensation scales in
training instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.dropout import dimmed

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians


@register("reg", "removal")
@dataclass(frozen=True)
class Removal(Regularizer):
    """p: share of the Gaussians that a render leaves out."""

    defaults: ClassVar[dict[str, float]] = {"start": 0.1}

    p: float = 0.2

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p < 1, "a number in (0, 1)")

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor, Any]:
        import torch

        kept = ctx.rng("removal").random(len(ctx.gaussians)) >= self.p
        return torch.from_numpy(kept).float(), state

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: Any) -> Gaussians:
        """Opacities times 1 - p."""
        return dimmed(gaussians, 1 - self.p)
