"""`reg=removal`: drop random Gaussians at a constant rate; scale opacities in tests.

The first of two strategies against co-adaptation (Chen et al. 2025, arXiv 2508.12720): a training
render leaves out a share p. The evaluation uses all Gaussians with opacities times 1 - p, so that
both absorb the same in expectation. `reg=uniform` with `compensate` scales in training instead.
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
    """Options of `reg=removal`.

    Attributes:
        p: share of the Gaussians that a render leaves out.
    """

    title: ClassVar[str] = "Removal"
    paper: ClassVar[str] = "coadapt"

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
