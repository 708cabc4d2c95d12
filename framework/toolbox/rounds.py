"""Common part of capacities that change the set in rounds of pruning and splitting.

A subclass decides, from the Fisher information of all training views, which Gaussians stay and how
many are split. When a round is due and how a Gaussian is split are shared. A split replaces a
Gaussian by two along its longest axis, with its colour, opacity and second moment. Standard
deviations are 0.6 and offsets 0.8 of the parent's (0.6^2 + 0.8^2 = 1). Light to import.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from framework.errors import require
from framework.plugin import Edits, StepContext, StepStats
from framework.toolbox.file_size import EXPECTED, MINIMUM, UNLIMITED, file_bytes, most_gaussians
from framework.toolbox.pull import Pull, PullCapacity

if TYPE_CHECKING:
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import Gaussians

NARROWED, OFFSET = 0.6, 0.8
SETTLED = 10  # epochs between rounds, as with three views; with fewer, rounds do less
SH0 = 11  # where the colours begin in a diagonal


@dataclass(frozen=True)
class TrainingInformation:
    """total: the sum over the training views, float64; visible: to any of them. colours: [N, 3],
    every view's part about sh0."""

    total: FisherInformation
    colours: tuple[Tensor, ...]


@dataclass(frozen=True)
class Selection:
    """keep: [N] bool. n_split: how many of those are split, each adds one Gaussian. bands, sh0: see
    `Edits`."""

    keep: Tensor
    n_split: int = 0
    bands: Tensor | None = None
    sh0: Tensor | None = None


@dataclass(frozen=True)
class RoundsCapacity(PullCapacity):
    """every: share of the training from one round to the next. grow: of the Gaussians kept, the
    share that a round splits, the strongest pulled first; by default all. until: share of the
    training after which none is split any more. Rounds begin at the framework key `start` and end
    at `stop`. bytes: the size of the compact file that the Gaussians must fit into, as 300kB.
    Members (`trainer.members`) share it."""

    defaults: ClassVar[dict[str, float]] = {"start": 0.05, "stop": 0.75}

    every: float = 0.1
    grow: float = 1.0
    until: float = 0.6
    bytes: str = UNLIMITED

    def __post_init__(self) -> None:
        self.check("bytes", file_bytes(self.bytes) is not None, EXPECTED)
        self.check("every", 0 < self.every <= 1, "a share in (0, 1]")
        self.check("grow", 0 <= self.grow <= 1, "a share in [0, 1]")
        self.check("until", 0 <= self.until <= 1, "a share in [0, 1]")

    def check_span(self, start: float, stop: float) -> None:
        require(
            self.until <= stop,
            f"capacity={self.name}: expected until <= stop, got until={self.until}, stop={stop};"
            " set capacity.until or capacity.stop",
        )
        if self.bytes != UNLIMITED:
            self.check_limited(start)

    def check_limited(self, start: float) -> None:
        """Raise UserError if no round comes that could bring the number of Gaussians to a limit."""
        last = math.floor(self.until / self.every + 1e-9) * self.every
        require(
            start < last,
            f"capacity={self.name}: expected a round after start and up to until, or the number is"
            f" never brought to the limit, got start={start}, every={self.every},"
            f" until={self.until}",
        )

    def shared(self, members: int) -> Self:
        size = file_bytes(self.bytes)
        if not size:
            return self
        require(
            size // members >= MINIMUM,
            f"capacity.bytes={self.bytes}: expected at least 1 kB for each of the {members} joined"
            " trainings; raise it, or set trainer.members=1",
        )
        return replace(self, bytes=str(size // members))

    def limit(self, ctx: StepContext) -> int | None:
        """The number of Gaussians that fit into `bytes`; None without a limit."""
        size = file_bytes(self.bytes)
        return most_gaussians(size, ctx.gaussians.sh_degree) if size else None

    def selected(self, ctx: StepContext, information: TrainingInformation) -> Selection:
        """Select the Gaussians that a round keeps and splits, from the views' information."""
        raise NotImplementedError

    def update(self, ctx: StepContext, state: Pull, stats: StepStats) -> tuple[Edits | None, Pull]:
        pull = self.measured(state, stats) if self.splits_again(ctx) else state
        if (ctx.step + 1) % self._interval(ctx) != 0:
            return None, pull
        chosen = self.selected(ctx, training_information(ctx))
        keep, n_split = chosen.keep, chosen.n_split
        if keep.all() and n_split == 0 and chosen.bands is None:
            return None, pull
        edits = _edits(ctx.gaussians, keep, pull.mean, n_split)
        edits = replace(edits, bands=chosen.bands, sh0=chosen.sh0)
        for name, count in (("pruned", int((~keep).sum())), ("split", n_split)):
            ctx.log(name, count)
        return edits, self.unmeasured(int(keep.sum()) + n_split)

    def within(self, ctx: StepContext, chosen: Selection, energy: Tensor) -> Selection:
        """`chosen` with as many Gaussians fewer as brings their number to the limit at `until` in
        equal ratios; those of the least energy [N] go."""
        import torch

        limit, n_kept = self.limit(ctx), int(chosen.keep.sum())
        total = n_kept + chosen.n_split
        if limit is None or total <= limit:
            return chosen
        wanted = round(total * (limit / total) ** (1 / max(1, self.rounds_left(ctx))))
        n_kept = math.ceil(n_kept * wanted / total)
        order = energy.masked_fill(~chosen.keep, -1).argsort(descending=True, stable=True)
        keep = torch.zeros_like(chosen.keep)
        keep[order[:n_kept]] = True
        return replace(chosen, keep=keep, n_split=wanted - n_kept)

    def splits_again(self, ctx: StepContext) -> bool:
        """Whether a round that is to come may split, for which alone the pull is measured."""
        return self.rounds_left(ctx) > 0

    def growing(self, ctx: StepContext) -> bool:
        """Whether another round follows before `until`, to judge what is split now."""
        return self.rounds_left(ctx) > 1

    def rounds_left(self, ctx: StepContext) -> int:
        """The number of rounds up to `until`, one that is due after this step included; 0 then."""
        interval = self._interval(ctx)
        last = math.floor(self.until * ctx.n_steps) // interval
        return max(0, last - math.ceil((ctx.step + 1) / interval) + 1)

    def settled(self, ctx: StepContext) -> float:
        """Epochs from one round to the next in units of `SETTLED`, at most 1. With many views, or
        few steps, training has not yet adapted to the last round."""
        return min(1.0, self._interval(ctx) / (SETTLED * len(ctx.views)))

    def _interval(self, ctx: StepContext) -> int:
        """Steps from one round to the next."""
        return ctx.steps_of(self.every)


def training_information(ctx: StepContext) -> TrainingInformation:
    """Information of the training views on the current Gaussians, of all pixels: surfaces continue
    where a photo's mask ends, and other views see them (docs/decisions.md)."""
    from framework.fisher.information import FisherInformation

    total, colours = None, []
    for view in ctx.views:
        of_view = ctx.fisher(view.camera)
        colours.append(of_view.diagonal[:, SH0:].clone())
        block, diagonal = of_view.block.double(), of_view.diagonal.double()
        if total is None:
            total = FisherInformation(block, diagonal, of_view.visible)
            continue
        visible = total.visible | of_view.visible
        total = FisherInformation(total.block + block, total.diagonal + diagonal, visible)
    assert total is not None, "a training has a view"
    return TrainingInformation(total, tuple(colours))


def _edits(gaussians: Gaussians, keep: Tensor, pull: Tensor, n_split: int) -> Edits:
    """Keep `keep`, of which the `n_split` strongest pulled are replaced by two each."""
    if n_split == 0:
        return Edits(keep)
    strongest = pull.masked_fill(~keep, -1).argsort(descending=True, stable=True)[:n_split]
    whole = keep.clone()
    whole[strongest] = False
    return Edits(whole, halves(gaussians[keep & ~whole]))


def halves(parents: Gaussians) -> Gaussians:
    """The 2 P Gaussians that P parents are split into."""
    import torch

    from framework.compute import portable
    from framework.geometry import rotation_matrices
    from framework.types import concatenate

    rows, longest = torch.arange(len(parents)), parents.log_scales.argmax(1)
    axes = rotation_matrices(parents.quats)[rows, :, longest]
    widths = torch.from_numpy(portable.exp(parents.log_scales.amax(1).numpy())).float()
    offsets = OFFSET * axes * widths[:, None]
    log_scales = parents.log_scales.clone()
    log_scales[rows, longest] += math.log(NARROWED)
    narrowed = parents.replace(log_scales=log_scales)
    return concatenate([narrowed.replace(means=parents.means + side * offsets) for side in (-1, 1)])
