"""`reg=depth_rank`: pixels that are known to be nearer should be rendered nearer.

SparseNeRF (Wang et al. 2023, its training code). For random pairs of pixels whose first is nearer
by the known depth: the mean of max(d1 - d2 + margin, 0). For neighbours of similar known depth: the
mean of max(|d1 - d2| - margin, 0). Depths are in units of the scene's near bound, so margins mean
the same everywhere. Only the order of the known depth counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.elsewhere import SEEN, known_depth

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Render, View


@register("reg", "depth_rank")
@dataclass(frozen=True)
class DepthRank(Regularizer):
    """A ranking loss on depth."""

    title: ClassVar[str] = "Depth ranking"
    paper: ClassVar[str] = "sparsenerf"

    defaults: ClassVar[dict[str, float]] = {"weight": 0.5}

    pairs: int = 2048  # random pairs of pixels per render
    margin: float = 1e-4  # by how much the nearer pixel should be nearer, in near bounds
    continuity: float = 0.01  # weight of the neighbour term relative to the pair term
    alike: float = 0.01  # relative difference of known depth below which neighbours stay together

    def __post_init__(self) -> None:
        self.check("pairs", self.pairs >= 1, "an integer >= 1")
        self.check("margin", self.margin >= 0, "a number >= 0")
        self.check("continuity", self.continuity >= 0, "a number >= 0")
        self.check("alike", self.alike > 0, "a number > 0")

    def loss(self, ctx: StepContext, state: Any, view: View, render: Render) -> Tensor | None:
        """Mean hinge over pairs plus `continuity` times that over neighbours."""
        import torch

        reference = known_depth(ctx, view)
        if reference is None:
            return None
        depth, valid = reference
        valid = valid & (render.alpha.detach() > SEEN)
        places = valid.reshape(-1).nonzero()[:, 0]
        if len(places) < 2:
            return None
        drawn = ctx.rng("pairs").integers(len(places), size=(2, self.pairs))
        first, second = places[torch.from_numpy(drawn)]
        rendered = render.expected_depth / ctx.near
        flat, sure = rendered.reshape(-1), depth.reshape(-1)
        nearer = torch.where(sure[first] < sure[second], first, second)
        farther = first + second - nearer
        ordered = sure[nearer] < sure[farther]
        hinge = (flat[nearer] - flat[farther] + self.margin).clamp(min=0)
        total = (hinge * ordered).sum() / ordered.sum().clamp(min=1)
        return total + self.continuity * self._continuity(rendered, depth, valid)

    def _continuity(self, rendered: Tensor, depth: Tensor, valid: Tensor) -> Tensor:
        """Mean excess of the steps between neighbours of like known depth, along both axes."""
        total, count = rendered.new_zeros(()), 0
        for axis in (0, 1):
            n = depth.shape[axis]
            a, b = depth.narrow(axis, 0, n - 1), depth.narrow(axis, 1, n - 1)
            both = valid.narrow(axis, 0, n - 1) & valid.narrow(axis, 1, n - 1)
            together = both & ((a - b).abs() <= self.alike * a.minimum(b))
            excess = (rendered.diff(dim=axis).abs() - self.margin).clamp(min=0)
            total, count = total + (excess * together).sum(), count + int(together.sum())
        return total / max(1, count)
