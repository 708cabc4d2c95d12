"""The common part of regularizers that drop Gaussians from a training render.

Such a method is a subclass that decides which Gaussians are dropped. How many, p(t) N in
expectation, how that grows over the training, and when the method acts are here, so that methods
compare at the same rate. Light to import.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

SCHEDULES = ("linear", "constant")


@dataclass(frozen=True)
class DropoutRegularizer(Regularizer, ABC):
    """p: the paper's drop rate, the expected share of Gaussians dropped in a step. schedule:
    "linear" gives p(t) = p x progress of the whole training (as DropGaussian's), "constant" keeps
    p. compensate: scale up what is kept, so that every opacity keeps its expectation. scale_tested:
    evaluate every opacity times its expected factor in the last step. It is weight scaling
    (Srivastava et al. 2014), the other way for both to absorb alike, and needs a method that acts
    to the end. The framework key `start` sets the warm-up.
    """

    p: float = 0.1
    schedule: str = "linear"
    compensate: bool = False
    scale_tested: bool = False

    # chosen on the embedded scene and on held-out training views of two real ones: a last fifth
    # without dropout lets the opacities settle
    defaults: ClassVar[dict[str, float]] = {"start": 0.1, "stop": 0.8}

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p < 1, "a number in (0, 1)")
        self.check("schedule", self.schedule in SCHEDULES, f"one of {', '.join(SCHEDULES)}")
        both = self.compensate and self.scale_tested
        self.check("scale_tested", not both, "false beside compensate=true, which leaves nothing")

    def check_span(self, start: float, stop: float) -> None:
        whole = not self.scale_tested or stop == 1
        self.check(
            "scale_tested", whole, "false, or reg.stop=1: what ended earlier leaves no trace"
        )

    def drop_rate(self, progress: float) -> float:
        """p(t), the expected share of Gaussians dropped at `progress` in [0, 1)."""
        return self.p * progress if self.schedule == "linear" else self.p

    @abstractmethod
    def expected_factors(self, ctx: StepContext, state: Any) -> Tensor | float:
        """Return the expected opacity factors of a training render without `compensate`: [N] or one
        number."""

    def evaluated(self, ctx: StepContext, gaussians: Gaussians, state: Any) -> Gaussians:
        """With `scale_tested`, scale opacities to the expectation of training renders."""
        if not self.scale_tested:
            return gaussians
        return dimmed(gaussians, self.expected_factors(ctx, state))


def dimmed(gaussians: Gaussians, factors: Tensor | float) -> Gaussians:
    """Opacities times `factors`, [N] or one for all, in (0, 1]; where that is 1 nothing changes.

    f sigmoid(x) = sigmoid(log f - log(exp(-x) + 1 - f)), which holds for opacities of 0 too.
    """
    import torch

    from framework.compute.portable import exp, log

    logits = gaussians.opacity_logits.detach()
    f = torch.as_tensor(factors, dtype=torch.float64).expand_as(logits)
    dimmer = log(f.numpy()) - log(exp(-logits.double().clamp(min=-80).numpy()) + (1 - f).numpy())
    thin = torch.where(f < 1, torch.from_numpy(dimmer).float(), logits)
    return gaussians.replace(opacity_logits=thin)
