"""`reg=uniform`: dropout of random Gaussians, all with the same probability.

A training render leaves out a share p(t) of the Gaussians, so that none can rely on others to hide
its errors. With `compensate` the kept opacities are multiplied by 1 / (1 - p(t)), which keeps their
expectation: DropGaussian (Park et al., CVPR 2025); `reg=dropgaussian` has its p and span.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, Variant, register
from framework.toolbox.dropout import DropoutRegularizer

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

COUNTS = ("bernoulli", "exact")


@register("reg", "uniform")
@dataclass(frozen=True)
class Uniform(DropoutRegularizer):
    """p: drop rate. schedule: "linear" gives p(t) = p x progress of the whole training, "constant"
    keeps p.

    Attributes:
        count: "bernoulli" drops each Gaussian with probability p(t), "exact" drops p(t) N of them,
            rounded. compensate: multiply the kept opacities by 1 / (1 - expected share dropped).
            DropGaussian does so; the renderer clamps alpha if that exceeds 1. scale_tested: instead
            evaluate opacities times 1 - p(t).
    """

    title: ClassVar[str] = "Uniform dropout"
    paper: ClassVar[str] = "safi_uar"
    variants: ClassVar[dict[str, Variant]] = {
        "dropgaussian": Variant("compensate", True, "DropGaussian", "dropgaussian"),
    }

    count: str = "bernoulli"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("count", self.count in COUNTS, f"one of {', '.join(COUNTS)}")

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        import torch

        total, rate = len(ctx.gaussians), self._rate(ctx)
        if rate == 0:
            return None, state
        dropped = torch.from_numpy(self._dropped(ctx.rng("uniform"), total, rate))
        kept = 1 / (1 - rate) if self.compensate else 1.0
        return torch.where(dropped, 0.0, kept).float(), state

    def expected_factors(self, ctx: StepContext, state: Any) -> float:
        return 1 - self._rate(ctx)

    def _rate(self, ctx: StepContext) -> float:
        """The share that is dropped now."""
        total, rate = len(ctx.gaussians), self.drop_rate(ctx.progress)
        return min(round(rate * total), total - 1) / total if self.count == "exact" else rate

    def _dropped(self, rng: np.random.Generator, total: int, rate: float) -> np.ndarray:
        """[total] bool, which Gaussians are left out."""
        draws = rng.random(total)
        if self.count == "bernoulli":
            return draws < rate
        dropped = draws < 0  # none yet
        dropped[draws.argsort(kind="stable")[: round(rate * total)]] = True
        return dropped
