"""`augment=safi`: a pseudo view warped from the views that Fisher information selects.

For a perturbed camera x' every training view k is scored by the information that x' would add to
it, I_k = 1/2 tr(F(x') F(x_k)^-1). F is diagonal and taken at the warmed-up Gaussians theta_0. A
small I_k means that view k already determines what x' would show. All views with
I_k <= eta min I are warped into x'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.warping import ThresholdAugmenter

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, Gaussians, View

FORMS = ("trace", "log")  # see framework.fisher.scores.information_gains
APPROXIMATIONS = ("diagonal", "block")


@dataclass(frozen=True)
class Snapshot:
    """theta_0 and the information of the training views about it.

    Attributes:
        gaussians: detached copies.
        unknown: for each of the K views the variances [N, P] of the diagonal parameters.
        blocks, prior: with blocks, the views' information [N, 6, 6] and its prior [6].
        epoch: when it was taken.
    """

    gaussians: Gaussians
    sh_degree: int
    unknown: tuple[Tensor, ...]
    blocks: tuple[Tensor, ...]
    prior: Tensor | None
    epoch: int


@register("augment", "safi")
@dataclass(frozen=True)
class Safi(ThresholdAugmenter):
    """Selects support views by Fisher information.

    eta: a view is a support if I_k is at most eta x the smallest. With form "log" the ratios are
    near 1, so use an eta of about 1.05. With a regulariser far below 1 the trace counts only what a
    view does not show.
    """

    title: ClassVar[str] = "SAFI"
    paper: ClassVar[str] = "safi_uar"

    form: str = "trace"  # "trace", the paper's bound, or "log", the gain itself
    approximation: str = "diagonal"  # "diagonal", or the "block" of each mean and log-scale
    regulariser: float = 1.0  # prior precision as a share of the views' median diagonal
    downscale: int = 2  # factor by which images are reduced for Fisher passes
    refresh_epochs: int = 0  # epochs after which theta_0 is taken again; 0 = never

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("form", self.form in FORMS, f"one of {', '.join(FORMS)}")
        valid = self.approximation in APPROXIMATIONS
        self.check("approximation", valid, f"one of {', '.join(APPROXIMATIONS)}")
        self.check("regulariser", 0 < self.regulariser <= 1e3, "a number in (0, 1000]")
        self.check("downscale", 1 <= self.downscale <= 16, "an integer in [1, 16]")
        self.check("refresh_epochs", self.refresh_epochs >= 0, "an integer >= 0")

    def check_selection(
        self, selection: Snapshot | None, gaussians: Gaussians, views: tuple[View, ...]
    ) -> None:
        from framework.shapes import check_count, check_gaussians, check_kind

        check_kind("safi.selection", selection, Snapshot, type(None))
        if selection is None:
            return
        terms = gaussians.shN.shape[1]
        check_gaussians("safi.gaussians", selection.gaussians, None, terms)
        check_count("safi.sh_degree", selection.sh_degree, selection.gaussians.sh_degree)
        check_count("safi.epoch", selection.epoch)
        self._check_information(selection, len(views))

    def _check_information(self, snapshot: Snapshot, n_views: int) -> None:
        import torch

        from framework.shapes import check_kind, check_tensor

        n, block = len(snapshot.gaussians), self.approximation == "block"
        _check_views("safi.unknown", snapshot.unknown, n_views, n, 8 if block else 14)
        _check_views("safi.blocks", snapshot.blocks, n_views if block else 0, n, 6, 6)
        if block:
            check_tensor("safi.prior", snapshot.prior, 6, dtype=torch.float64)
        else:
            check_kind("safi.prior", snapshot.prior, type(None))

    def scores(
        self, ctx: StepContext, selection: Snapshot | None, camera: Camera
    ) -> tuple[list[float], Snapshot]:
        from framework.fisher.scores import gains_over, information_gains

        snapshot = selection
        if snapshot is None or self._outdated(snapshot, ctx.epoch):
            snapshot = self._snapshot(ctx)
        block, diagonal = self._information(ctx, snapshot.gaussians, snapshot.sh_degree, camera)
        gains = gains_over(diagonal, snapshot.unknown, self.form)
        if block is None or snapshot.prior is None:
            return gains, snapshot
        of_blocks = information_gains(block, snapshot.blocks, snapshot.prior, self.form)
        return [sum(both) for both in zip(of_blocks, gains, strict=True)], snapshot

    def _outdated(self, snapshot: Snapshot, epoch: int) -> bool:
        return 0 < self.refresh_epochs <= epoch - snapshot.epoch

    def _snapshot(self, ctx: StepContext) -> Snapshot:
        from framework.fisher.scores import block_prior, shared_prior, variances

        gaussians, degree = ctx.gaussians.clone(), ctx.sh_degree
        views = [self._information(ctx, gaussians, degree, v.camera, v.mask) for v in ctx.views]
        diagonals = [diagonal for _, diagonal in views]
        prior = shared_prior(diagonals, self.regulariser)
        unknown = tuple(variances(diagonal, prior) for diagonal in diagonals)
        blocks = tuple(block for block, _ in views if block is not None)
        of_blocks = block_prior(blocks, self.regulariser) if blocks else None
        return Snapshot(gaussians, degree, unknown, blocks, of_blocks, ctx.epoch)

    def _information(
        self,
        ctx: StepContext,
        gaussians: Gaussians,
        sh_degree: int,
        camera: Camera,
        mask: Tensor | None = None,
    ) -> tuple[Tensor | None, Tensor]:
        """Fisher information of theta_0 in `camera`, float64, with lengths in scene extents.

        Returns:
            None and the diagonal [N, 14], or blocks [N, 6, 6] and the rest's diagonal [N, 8].
        """
        import torch

        factor = min(self.downscale, camera.width, camera.height)
        small = camera.scaled(factor)
        if mask is not None:
            mask = mask[factor // 2 :: factor, factor // 2 :: factor][: small.height, : small.width]
        information = ctx.fisher(small, gaussians, sh_degree, mask)
        unit = torch.ones(information.diagonal.shape[1], dtype=torch.float64)
        unit[:3] = ctx.extent
        diagonal = information.diagonal * unit**2
        if self.approximation == "diagonal":
            return None, diagonal
        return information.block * (unit[:6, None] * unit[:6]), diagonal[:, 6:].contiguous()


def _check_views(where: str, value: tuple[Tensor, ...], n_views: int, *shape: int) -> None:
    """Raise ValueError unless `value` has a float64 tensor of `shape` for every view."""
    import torch

    from framework.shapes import check_kind, check_tensor

    check_kind(where, value, tuple)
    if len(value) != n_views:
        raise ValueError(f"{where}: expected {n_views} views, got {len(value)}")
    for tensor in value:
        check_tensor(where, tensor, *shape, dtype=torch.float64)
