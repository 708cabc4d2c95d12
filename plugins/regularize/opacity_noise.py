"""`reg=opacity_noise`: multiply opacities of training renders by noise around 1.

No Gaussian can then rely on the exact opacity of another. The second of two strategies against
co-adaptation (Chen et al. 2025, arXiv 2508.12720): o <- clamp(o (1 + e), 0, 1) with e from
N(0, sigma^2), clipped at sigma.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register

if TYPE_CHECKING:
    from torch import Tensor


@register("reg", "opacity_noise")
@dataclass(frozen=True)
class OpacityNoise(Regularizer):
    """Options of `reg=opacity_noise`.

    Attributes:
        sigma: standard deviation of the noise, and its largest size.
    """

    title: ClassVar[str] = "Opacity noise"
    paper: ClassVar[str] = "coadapt"

    drops: ClassVar[bool] = False
    defaults: ClassVar[dict[str, float]] = {"start": 0.1}

    sigma: float = 0.8

    def __post_init__(self) -> None:
        self.check("sigma", 0 < self.sigma <= 1, "a number in (0, 1]")

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor, Any]:
        import torch

        from framework.compute.tensors import sigmoid

        draws = torch.from_numpy(ctx.rng("noise").standard_normal(len(ctx.gaussians)))
        noise = (self.sigma * draws).clamp(-self.sigma, self.sigma).float()
        highest = 1 / sigmoid(ctx.gaussians.opacity_logits).clamp(min=1e-12)  # an opacity of 1
        return torch.minimum(1 + noise, highest), state
