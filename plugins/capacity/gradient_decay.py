"""`capacity=gradient_decay`: opacities decay, less so where their gradient is large.

StereoGS (2026, gradient-aware decay): after each step an opacity o is multiplied by
1 - (1 - decay) exp(-relief g / mean(g)) with g = |dL/do|. Unneeded Gaussians vanish and supported
ones stay. The mean is over Gaussians with a gradient, so that the visible share of the scene does
not matter. Gradients are those of the logits before the step, converted to opacities by the values
after it, which differ by one optimizer step. The trainer decays opacities by default as well;
`trainer.opacity_decay=1` disables that. Use it alone or with another capacity:
`capacity=[adc_paper,gradient_decay]`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register

if TYPE_CHECKING:
    from torch import Tensor

LOWEST = -30.0  # no logit fades below, as in the trainer's own decay


@register("capacity", "gradient_decay")
@dataclass(frozen=True)
class GradientDecay(Capacity):
    """Options of `capacity=gradient_decay`.

    Attributes:
        decay: factor of an opacity without a gradient after a step.
        relief: how much less opacities with a gradient decay; 0 = all alike.
    """

    title: ClassVar[str] = "Gradient-aware decay"
    paper: ClassVar[str] = "stereogs"

    gradients: ClassVar[tuple[str, ...]] = ("opacity_logits",)

    decay: float = 0.99
    relief: float = 0.5

    def __post_init__(self) -> None:
        self.check("decay", 0 < self.decay < 1, "a number in (0, 1)")
        self.check("relief", 0 <= self.relief < 1e6, "a number in [0, 1e6)")

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        logits, gradient = ctx.gaussians.opacity_logits, stats.gradients["opacity_logits"]
        faded, kept = fade(logits, gradient, self.decay, self.relief)
        ctx.log(f"{self.name}_factor", kept)
        return Edits(values={"opacity_logits": faded}), state


def fade(logits: Tensor, gradient: Tensor, decay: float, relief: float) -> tuple[Tensor, float]:
    """[N] logits of the faded opacities, and the mean factor.

    Args:
        logits, gradient: [N] of the opacities, and the loss' in them.
    """
    import numpy as np
    import torch

    from framework.compute.portable import exp, log

    x = logits.double().numpy()
    odds_against = exp(-x)  # (1 - o) / o
    # do = o (1 - o) dx, and 1 / (o (1 - o)) = 2 + e^x + e^-x
    g = gradient.double().abs().numpy() * (2 + exp(x) + odds_against)
    pulled = g > 0
    mean = g[pulled].mean() if pulled.any() else 1.0
    lost = (1 - decay) * exp(-relief * g / mean)
    # o (1 - lost) as a logit: of saturated opacities too, where 1 - o is 0
    faded = np.maximum(log(1 - lost) - log(lost + odds_against), LOWEST)
    return torch.from_numpy(faded).float(), float((1 - lost).mean())
