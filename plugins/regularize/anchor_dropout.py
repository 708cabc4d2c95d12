"""`reg=anchor_dropout`: drop random Gaussians together with their nearest neighbours.

ReDI-GS (2026, DropAnSH): neighbours replace a single dropped Gaussian. Therefore anchors are drawn
at a rate that grows from 0 to p, and each also drops its k nearest neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import Regularizer, StepContext, register
from framework.toolbox.neighbours import nearest_others

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians, View


@register("reg", "anchor_dropout")
@dataclass(frozen=True)
class AnchorDropout(Regularizer):
    """Options of `reg=anchor_dropout`.

    Attributes:
        p: share of anchors at the end.
        neighbours: dropped with each anchor.
        refresh: share of the training between two searches for neighbours. A changed set of
            Gaussians is searched at once.
        compensate: divide the kept opacities by the kept share (unknown for ReDI-GS).
    """

    title: ClassVar[str] = "Anchor dropout"
    paper: ClassVar[str] = "dropansh"

    defaults: ClassVar[dict[str, float]] = {"start": 0.1}

    p: float = 0.02
    neighbours: int = 10
    refresh: float = 0.1
    compensate: bool = False

    def __post_init__(self) -> None:
        self.check("p", 0 < self.p < 1, "a number in (0, 1)")
        self.check("neighbours", 0 <= self.neighbours <= 1000, "an integer in [0, 1000]")
        self.check("refresh", 0 < self.refresh <= 1, "a share in (0, 1]")

    def check_state(
        self, state: Any, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        import torch

        from framework.shapes import check_count, check_kind, check_tensor

        check_kind(self.name, state, tuple, type(None))
        if state is None:
            return
        rows, step, of_version = state
        check_count(self.name, step)
        check_count(self.name, of_version, version)
        n = len(gaussians)
        shape = (n, None) if of_version == version else (None, None)
        check_tensor(self.name, rows, *shape, dtype=torch.int64)
        if (
            of_version == version
            and rows.numel()
            and not 0 <= int(rows.min()) <= int(rows.max()) < n
        ):
            raise ValueError(f"{self.name}: expected rows of {n} Gaussians")

    def opacity_factors(self, ctx: StepContext, state: Any) -> tuple[Tensor | None, Any]:
        import torch

        n = len(ctx.gaussians)
        if (
            state is None
            or state[2] != ctx.version
            or ctx.step - state[1] >= ctx.steps_of(self.refresh)
        ):
            rows = nearest_others(ctx.gaussians.means, self.neighbours)[1]
            state = rows.contiguous(), ctx.step, ctx.version
        anchors = ctx.rng("anchors").random(n) < self.p * ctx.progress
        dropped = torch.from_numpy(anchors)
        if not dropped.any():
            return None, state
        kept = (~dropped).float()
        kept[state[0][dropped].reshape(-1)] = 0
        return kept / kept.mean().clamp(min=1e-6) if self.compensate else kept, state
