"""`capacity=edge_split`: split large Gaussians that cover edges of a photo.

DropoutGS (Xu et al. 2025, edge-guided splitting), in addition to adaptive density control. A
Gaussian is split if its largest standard deviation is above a share of the scene's extent and its
edge score is above a threshold. The score is the mean of the photo's edges (Sobel) under the
Gaussian, weighted by its blend weights. These are the derivative of the image by its colour, so one
render gives them all. The score uses the step's view alone, as the paper does not define its sum
over pixels. Combine it with another capacity, as `capacity=[adc,edge_split]`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Capacity, Edits, StepContext, StepStats, register
from framework.toolbox.rounds import halves

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import View


@register("capacity", "edge_split")
@dataclass(frozen=True)
class EdgeSplit(Capacity):
    """Splits large Gaussians on edges."""

    title: ClassVar[str] = "Edge-guided splitting"
    paper: ClassVar[str] = "dropoutgs"

    defaults: ClassVar[dict[str, float]] = {"start": 0.1, "stop": 0.7}

    score: float = 0.1  # least edge score of a Gaussian that is split
    large: float = 0.01  # its least standard deviation, in scene extents
    every: float = 0.05  # share of the training between two rounds
    at_most: float = 0.05  # largest share of the Gaussians that a round splits

    def __post_init__(self) -> None:
        self.check("score", 0 <= self.score <= 1, "a number in [0, 1]")
        self.check("large", 0 <= self.large < 1e6, "a number in [0, 1e6)")
        self.check("every", 0 < self.every <= 1, "a share in (0, 1]")
        self.check("at_most", 0 < self.at_most <= 1, "a share in (0, 1]")

    def update(self, ctx: StepContext, state: Any, stats: StepStats) -> tuple[Edits | None, Any]:
        import torch

        from framework.compute.tensors import exp

        if not ctx.due(self.every) or stats.view is None:
            return None, state
        score = edge_scores(ctx, stats.view)
        large = exp(ctx.gaussians.log_scales.max(1).values) > self.large * ctx.extent
        chosen = (large & (score >= self.score)).nonzero()[:, 0]
        most = max(1, int(self.at_most * len(score)))
        chosen = chosen[score[chosen].argsort(descending=True, stable=True)[:most]]
        ctx.log(f"{self.name}_split", float(len(chosen)))
        if len(chosen) == 0:
            return None, state
        keep = torch.ones(len(score), dtype=torch.bool)
        keep[chosen] = False
        return Edits(keep=keep, append=halves(ctx.gaussians[~keep])), state


def edge_scores(ctx: StepContext, view: View) -> Tensor:
    """[N] mean of the view's edges under each Gaussian, weighted with its blend weights; 0 where it
    is not seen."""
    import torch

    edges = torch.stack([sobel(view.image), torch.ones(view.image.shape[1:])])
    # grey, as a colour below 0 is cut off and has no derivative
    grey = ctx.gaussians.replace(
        sh0=torch.zeros_like(ctx.gaussians.sh0).requires_grad_(),
        shN=torch.zeros_like(ctx.gaussians.shN),
    )
    rgb = ctx.render(view.camera, grey).rgb
    (sums,) = torch.autograd.grad((rgb[:2] * edges).sum(), [grey.sh0])
    weighted, weight = sums[:, 0, 0], sums[:, 0, 1]
    return torch.where(weight > 0, weighted / weight.clamp(min=1e-12), 0.0)


def sobel(image: Tensor) -> Tensor:
    """[H, W] length of Sobel's gradient of the grey image (mean of the channels), over 4, so that a
    step from 0 to 1 is 1; borders are continued."""
    import torch
    from torch.nn.functional import conv2d, pad

    from framework.compute.tensors import root

    kernel = torch.tensor([[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / 4
    grey = pad(image.mean(0)[None, None], (1, 1, 1, 1), mode="replicate")
    x, y = (conv2d(grey, k[None, None])[0, 0] for k in (kernel, kernel.T))
    return root(x.square() + y.square())
