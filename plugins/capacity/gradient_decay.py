"""`capacity=gradient_decay`: opacities fade, more so where the loss's gradient is small.

StereoGS (2026), the gradient-based decay of its project page. After each step an opacity o is
multiplied by 1 - (1 - decay) exp(-relief g / mean(g)) with g = |dL/do| of the step. So Gaussians
without effect disappear, and those that the photos need stay. The mean is over Gaussians with a
gradient, so it does not depend on how much of the scene a photo shows.

Gradients are those of the logits before the step. They are converted to opacities by the values
after it, which differ by one step of the optimizer. The trainer lets opacities fade by default too:
`trainer.opacity_decay=1` turns that off. It works alone or with another capacity, as
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
    """decay: what an opacity without a gradient is multiplied by after a step. relief: how much
    less one fades that has a gradient; 0 = all alike."""

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
    """[N] logits of the faded opacities, and the mean factor. logits, gradient: [N] of the
    opacities, and the loss' in them."""
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
