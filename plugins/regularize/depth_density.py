"""`reg=depth_density`: dropout that prefers near and crowded Gaussians.

D2GS (2025, depth- and density-guided dropout): the score of a Gaussian is half its nearness to the
cameras and half its local density. The near third is dropped with the score as probability, the
middle third with 0.7 and the far third with 0.3 times that. The paper does not state how its rate
(0.05 to 0.3 over the training) and the scores combine, and others could not reproduce its PSNR.
Here probabilities are scaled so that their mean is the rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.neighbours import nearest_others

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians, View

THIRDS = (1.0, 0.7, 0.3)  # factors of near, middle and far ones
NEIGHBOURS = 3


@register("reg", "depth_density")
@dataclass(frozen=True)
class DepthDensity(Regularizer):
    """Drops near and crowded Gaussians more often."""

    title: ClassVar[str] = "DD-Drop"
    paper: ClassVar[str] = "d2gs"

    defaults: ClassVar[dict[str, float]] = {"start": 0.1}

    first: float = 0.05  # mean drop rate at the beginning of the training
    last: float = 0.3  # mean drop rate at the end; linear in between
    refresh: float = 0.1  # share of the training after which scores are measured again
    compensate: bool = True  # divide kept opacities by their probability to be kept

    def __post_init__(self) -> None:
        self.check("first", 0 <= self.first < 1, "a share in [0, 1)")
        self.check("last", 0 <= self.last < 1, "a share in [0, 1)")
        self.check("refresh", 0 < self.refresh <= 1, "a share in (0, 1]")

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        from framework.shapes import check_count, check_kind, check_tensor

        check_kind(self.name, state, tuple, type(None))
        if state is None:
            return
        scores, step, of_version = state
        check_count(self.name, step)
        check_count(self.name, of_version, version)
        check_tensor(self.name, scores, len(gaussians) if of_version == version else None)

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        import torch

        old = state is None or state[2] != ctx.version
        if old or ctx.step - state[1] >= ctx.steps_of(self.refresh):
            state = scores(ctx), ctx.step, ctx.version
        rate = self.first + (self.last - self.first) * ctx.progress
        odds = (rate * state[0] / state[0].mean().clamp(min=1e-12)).clamp(max=1)
        draws = torch.from_numpy(ctx.rng("dropped").random(len(odds)))
        kept = (draws >= odds).float()
        return kept / (1 - odds).clamp(min=1e-6) if self.compensate else kept, state


def scores(ctx: StepContext) -> Tensor:
    """[N] in [0, 1]: half nearness, half crowdedness, both by rank, times the third's factor."""
    import torch

    means = ctx.gaussians.means
    centers = torch.stack([view.camera.center.float() for view in ctx.views])
    distance = torch.stack([(means - center).norm(dim=1) for center in centers]).min(0).values
    apart = nearest_others(means, NEIGHBOURS)[0].mean(1)
    nearness, crowded = (1 - ranks(values) for values in (distance, apart))
    third = (3 * ranks(distance)).long().clamp(max=2)
    return (0.5 * nearness + 0.5 * crowded) * torch.tensor(THIRDS)[third]


def ranks(values: Tensor) -> Tensor:
    """[N] place of each of [N] values in their order, over N: 0 for the smallest."""
    import torch

    order = values.argsort(stable=True)
    places = torch.empty_like(values)
    places[order] = torch.arange(len(values), dtype=values.dtype) / max(1, len(values))
    return places
