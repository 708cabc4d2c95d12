"""`reg=sh_dropout`: train random Gaussians without view-dependent colour.

ReDI-GS (2026), the colour half of its DropAnSH. In a step a share p of the Gaussians has its SH
bands above degree d zeroed: c' = m c with m = 0 there and 1 elsewhere. By the chain rule
dL/dc = m dL/dc' = 0 for these. The degree d is 0 in the first fifth of the training, 1 in the
second, 2 in the third. Later nothing is dropped, and never in an evaluation.

Only active bands can be dropped, so `trainer.sh_every` has to open them early enough (the paper:
every 1,000 of 10,000 steps). Steps that drop bands take a second pass.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import GradientAt, Regularizer, StepContext, register

if TYPE_CHECKING:
    from torch import Tensor

ROUNDING = 1e-9  # 3 x 0.2 is above 0.6 in floating point


@register("reg", "sh_dropout")
@dataclass(frozen=True)
class ShDropout(Regularizer):
    """Options of `reg=sh_dropout`.

    Attributes:
        p: share of the Gaussians without bands, drawn in every step.
        each: share of the training after which one more degree is spared; reg.stop ends it earlier.
    """

    title: ClassVar[str] = "SH dropout"
    paper: ClassVar[str] = "dropansh"

    defaults: ClassVar[dict[str, float]] = {"stop": 0.6}

    p: float = 0.2
    each: float = 0.2

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p <= 1, "a share in (0, 1]")
        self.check("each", 0 < self.each <= 1, "a share in (0, 1]")

    def gradient(
        self, ctx: StepContext, state: Any, gradients: Mapping[str, Tensor], at: GradientAt
    ) -> Mapping[str, Tensor] | None:
        """The gradient at colours that lack the dropped bands, 0 in these; None where no band is
        both active and due, which saves the second pass."""
        import torch

        spared = int(ctx.progress / self.each + ROUNDING)  # the highest degree that is kept
        if spared >= ctx.sh_degree:
            return None
        first = (spared + 1) ** 2 - 1  # shN has no column for degree 0
        lacking = torch.from_numpy(ctx.rng("lacking").random(len(ctx.gaussians.shN)) < self.p)
        ctx.log(f"{self.name}_without_bands", float(lacking.double().mean()))
        if not lacking.any():
            return None
        seen = ctx.gaussians.shN.detach().clone()
        seen[lacking, first:] = 0
        there = dict(at(ctx.gaussians.replace(shN=seen)))
        there["shN"] = there["shN"].clone()
        there["shN"][lacking, first:] = 0
        return there
