"""`capacity=adc`: adaptive density control of 3DGS (Kerbl et al. 2023, section 5.2).

Where the gradient of a projected mean stays large, the scene is under-represented: small Gaussians
are cloned there and large ones split in two. Transparent Gaussians are pruned, and opacities are
reset from time to time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from framework.plugin import Edits, StepContext, StepStats, register
from framework.toolbox.pull import Pull, PullCapacity

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

CHILDREN = 2  # a split Gaussian becomes two ...
SHRINK = 1.6  # ... smaller by this factor (the 3DGS code's 0.8 * CHILDREN)


@register("capacity", "adc")
@dataclass(frozen=True)
class AdaptiveDensityControl(PullCapacity):
    """Options, with the defaults of the sparse-view literature (trainings of 10,000 steps).

    With `of_steps` at 0 step numbers are absolute: a training of 500 steps or fewer is densified
    only if `from_step` is lowered. Otherwise they scale with the training's length, and at least an
    epoch lies between densifications. The last densification is before the framework key `stop`,
    whose default leaves the last tenth for splits to settle. Joined members (`trainer.members`)
    share `max_gaussians`.
    """

    title: ClassVar[str] = "ADC"
    paper: ClassVar[str] = "baseline"

    defaults: ClassVar[dict[str, float]] = {"stop": 0.9}

    of_steps: int = 0  # training length that other step numbers refer to; 0 = absolute numbers
    every: int = 100  # steps between densifications
    from_step: int = 500  # no densification up to this step
    grad_threshold: float = 5e-4  # least mean gradient (loss per NDC unit)
    percent_dense: float = 0.01  # largest deviation of a "small" Gaussian, in scene extents
    min_opacity: float = 0.005  # Gaussians with a lower opacity are removed
    reset_every: int = 3000  # steps between opacity resets; 0 = never
    reset_from: int = 0  # step of the first reset; 0 = reset_every
    reset_opacity: float = 0.01  # the highest opacity after a reset
    max_gaussians: int = 0  # 0 = no limit; otherwise those with the largest gradient come first
    absolute: bool = False  # use sums of absolute gradients (AbsGS, Ye et al. 2024); slower
    count_dropped: bool = False  # count dropped ones as seen, with gradient 0 (DropGaussian's code)

    def __post_init__(self) -> None:
        self.check("of_steps", self.of_steps >= 0, "an integer >= 0")
        self.check("every", self.every >= 1, "an integer >= 1")
        self.check("from_step", self.from_step >= 0, "an integer >= 0")
        self.check("grad_threshold", self.grad_threshold > 0, "a number > 0")
        self.check("percent_dense", self.percent_dense > 0, "a number > 0")
        self.check("min_opacity", 0 <= self.min_opacity < 1, "a number in [0, 1)")
        self.check("reset_every", self.reset_every >= 0, "an integer >= 0")
        self.check("reset_from", self.reset_from >= 0, "an integer >= 0")
        self.check("max_gaussians", self.max_gaussians >= 0, "an integer >= 0")
        self.check(
            "reset_opacity",
            self.reset_every == 0 or self.min_opacity < self.reset_opacity < 1,
            f"a number in (min_opacity, 1) = ({self.min_opacity}, 1), or all would be removed",
        )

    def shared(self, members: int) -> AdaptiveDensityControl:
        most = max(1, self.max_gaussians // members) if self.max_gaussians else 0
        return replace(self, max_gaussians=most)

    def wants_absolute(self) -> bool:
        return self.absolute

    def counts_dropped(self) -> bool:
        return self.count_dropped

    def update(self, ctx: StepContext, state: Pull, stats: StepStats) -> tuple[Edits | None, Pull]:
        """Measure; at every `every`-th step also clone, split and prune; then perhaps reset.

        `ctx.step` is the index of the step just made, hence one more are finished.
        """
        state, finished = self.measured(state, stats), ctx.step + 1
        every, first, reset, reset_from = (
            self._steps(ctx, n)
            for n in (self.every, self.from_step, self.reset_every, self.reset_from)
        )
        if self.of_steps > 0:
            every = max(every, len(ctx.views))
        past = finished - (reset_from or reset)  # steps since the first reset
        ceiling = self.reset_opacity if past >= 0 and _due(past, reset, -1) else None
        if _due(finished, every, first):
            edits, n = self._densified(ctx, state, ceiling)
            return edits, self.unmeasured(n)
        return (None if ceiling is None else Edits(opacity_ceiling=ceiling)), state

    def _steps(self, ctx: StepContext, n: int) -> int:
        """`n` steps of a training of `of_steps`, in this one; at least 1, unless n is 0."""
        if self.of_steps == 0 or n == 0:
            return n
        return max(1, round(n * ctx.n_steps / self.of_steps))

    def _densified(self, ctx: StepContext, state: Pull, ceiling: float | None) -> tuple[Edits, int]:
        """The edits of one densification and the number of Gaussians after them."""
        from framework.compute.portable import log
        from framework.types import concatenate

        gaussians = ctx.gaussians
        # compared as they are stored: PyTorch's exponential has other bits on other processors
        lowest = float(log(self.min_opacity / (1 - self.min_opacity)))
        opaque = gaussians.opacity_logits >= lowest
        chosen = self._chosen(state.mean, opaque)
        widest = float(log(self.percent_dense * ctx.extent))
        large = gaussians.log_scales.amax(1) > widest
        clone, split = chosen & ~large, chosen & large
        children = _children(gaussians[split], ctx.rng("split").standard_normal)
        for name, mask in (("cloned", clone), ("split", split), ("pruned", ~opaque)):
            ctx.log(name, float(mask.sum()))
        keep, append = opaque & ~split, concatenate([gaussians[clone], children])
        return Edits(keep, append, ceiling), int(keep.sum()) + len(append)

    def _chosen(self, pull: Tensor, opaque: Tensor) -> Tensor:
        """[N] bool: those to clone or split; each adds one Gaussian, up to `max_gaussians`."""
        import torch

        chosen = (pull >= self.grad_threshold) & opaque
        if self.max_gaussians == 0:
            return chosen
        room = max(self.max_gaussians - int(opaque.sum()), 0)
        strongest = torch.argsort(torch.where(chosen, pull, -1.0), descending=True, stable=True)
        served = torch.zeros_like(chosen)
        served[strongest[:room]] = True
        return chosen & served


def _due(step: int, every: int, after: int) -> bool:
    return every > 0 and step > after and step % every == 0


def _children(parents: Gaussians, standard_normal) -> Gaussians:  # type: ignore[no-untyped-def]
    """Two for each of P parents: means drawn from the parent's own distribution, scales / 1.6.

    standard_normal: shape -> array of independent N(0, 1) draws.
    """
    import torch

    from framework.compute.portable import exp
    from framework.geometry import rotation_matrices
    from framework.types import concatenate

    doubled = concatenate([parents] * CHILDREN)
    draws = torch.from_numpy(standard_normal((len(doubled), 3))).to(doubled.means.dtype)
    local = draws * torch.from_numpy(exp(doubled.log_scales.numpy())).float()
    offsets = (rotation_matrices(doubled.quats) * local[:, None, :]).sum(-1)
    return doubled.replace(
        means=doubled.means + offsets, log_scales=doubled.log_scales - math.log(SHRINK)
    )
