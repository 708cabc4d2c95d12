"""The pull of Gaussians: the loss's gradient in the projected mean, the criterion of densification.

The mean is in normalised device coordinates (x_ndc = 2 u / width - 1, so d/dx_ndc = width / 2
d/du). The pull is averaged over the steps that saw the Gaussian (3DGS, Kerbl et al. 2023, section
5.2). Unlike a gradient in pixels it does not depend on the resolution. With
`Capacity.wants_absolute` it is of absolute gradients (AbsGS, Ye et al. 2024). Light to import.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from framework.plugin import Capacity, StepContext, StepStats

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians, View


@dataclass(frozen=True)
class Pull:
    """Gradient statistics since Gaussians were last added or pruned.

    Attributes:
        total: [N] float32, summed gradient norms in NDC.
        seen: [N] float32, number of steps in which the Gaussian was visible.
    """

    total: Tensor
    seen: Tensor

    @property
    def mean(self) -> Tensor:
        """[N] average norm over the steps that saw it; 0 where none did."""
        return self.total / self.seen.clamp(min=1)


class PullCapacity(Capacity):
    """The common part of capacities whose state is the `Pull`."""

    def counts_dropped(self) -> bool:
        """Whether a step that drops Gaussians counts as having seen them, with a gradient of 0. It
        is not known which of them it would have seen: it counts by the share that it kept."""
        return False

    def init_state(self, ctx: StepContext) -> Pull:
        return self.unmeasured(len(ctx.gaussians))

    def check_state(
        self, state: Pull, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        from framework.shapes import check_kind, check_tensor

        check_kind(self.name, state, Pull)
        check_tensor(f"{self.name}.total", state.total, len(gaussians))
        check_tensor(f"{self.name}.seen", state.seen, len(gaussians))

    def unmeasured(self, n: int) -> Pull:
        """The state of a new set of `n` Gaussians."""
        import torch

        return Pull(torch.zeros(n), torch.zeros(n))

    def followed(self, state: Pull, rows: Tensor) -> Pull:
        old = rows.clamp(min=0)
        return Pull(state.total[old] * (rows >= 0), state.seen[old] * (rows >= 0))

    def measured(self, state: Pull, stats: StepStats) -> Pull:
        """`state` with the step of `stats` added."""
        from framework.compute.tensors import root

        visible = stats.radii > 0
        gradient = stats.means2d_grad
        if self.wants_absolute() and stats.absolute is not None:
            gradient = stats.absolute
        half_size = gradient.new_tensor([stats.width / 2, stats.height / 2])
        u, v = (gradient * half_size).square().unbind(1)
        norm = root(u + v)
        seen = visible.float()
        if self.counts_dropped() and stats.factors is not None:
            seen /= (stats.factors > 0).float().mean().clamp(min=1 / len(seen))
        return Pull(state.total + norm * visible, state.seen + seen)
