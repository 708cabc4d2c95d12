"""`reg=uar`: uncertainty-aware dropout of Gaussians (UAR).

The uncertainty of Gaussian i is U_i = -log det F_i, where F_i is the Fisher information of the
training views about its mean and log-scale. At progress t, the C p(t) N least uncertain Gaussians
are candidates, and each is dropped with probability 1/C for one step, p(t) N in expectation. This
moves supervision to uncertain Gaussians, which are never dropped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from framework.plugin import StepContext, Variant, register
from framework.toolbox.dropout import DropoutRegularizer

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians, View

MODES = ("soft", "hard")
FORMS = ("block", "diagonal")


@dataclass(frozen=True)
class Ranking:
    """Gaussians by uncertainty.

    Attributes:
        order: [M] int64, the Gaussians that any training view shows, least uncertain first.
        step: when it was computed.
        version: of the set of Gaussians.
    """

    order: Tensor
    step: int
    version: int


@register("reg", "uar")
@dataclass(frozen=True)
class Uar(DropoutRegularizer):
    """Options, with the paper's symbols.

    Attributes:
        mode: multiply a dropped opacity by 0 ("hard") or by `soft_scale` ("soft").
        soft_scale: lambda. p: drop rate. schedule: "linear" gives p(t) = p x progress of the whole
            training, as in DropGaussian, "constant" keeps p.
        candidate_factor: C, candidates per dropped Gaussian.
        refresh: steps between rankings.
        form: "block", log det of the 6x6 block, or "diagonal", of its diagonal, which ignores
            correlations.
        regulariser: prior precision as a share of the median diagonal of F. compensate: scale up
            kept candidates, so that opacities keep their expectation. It is by the factor
            (1-s/C)/(1-1/C), with s the factor of dropped ones. scale_tested: instead evaluate
            candidates at their mean opacity in training, 1 - (1 - s)/C times.
    """

    title: ClassVar[str] = "UAR"
    paper: ClassVar[str] = "safi_uar"
    variants: ClassVar[dict[str, Variant]] = {
        "uar_hard": Variant("mode", "hard", "UAR (hard)", "safi_uar"),
    }

    mode: str = "soft"
    candidate_factor: float = 2.0
    soft_scale: float = 0.2
    refresh: int = 100
    form: str = "block"
    regulariser: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("mode", self.mode in MODES, f"one of {', '.join(MODES)}")
        most = 1 / self.p
        within = f"a number in (1, 1 / reg.p) = (1, {round(most, 3)})"
        self.check("candidate_factor", 1 < self.candidate_factor < most, within)
        self.check("soft_scale", 0 <= self.soft_scale <= 1, "a number in [0, 1]")
        self.check("refresh", self.refresh >= 1, "an integer >= 1")
        self.check("form", self.form in FORMS, f"one of {', '.join(FORMS)}")
        self.check("regulariser", 0 < self.regulariser <= 1e3, "a number in (0, 1000]")

    def check_state(
        self, state: Ranking | None, gaussians: Gaussians, version: int, views: tuple[View, ...]
    ) -> None:
        import torch

        from framework.shapes import check_count, check_kind, check_tensor

        check_kind("uar", state, Ranking, type(None))
        if state is None:
            return
        check_count("uar.step", state.step)
        check_count("uar.version", state.version)
        check_tensor("uar.order", state.order, None, dtype=torch.int64)
        n = len(gaussians)
        if state.version == version and not bool(((state.order >= 0) & (state.order < n)).all()):
            raise ValueError(f"uar.order: expected indices of {n} Gaussians, got others")

    @property
    def dropped_factor(self) -> float:
        """What a dropped Gaussian's opacity is multiplied by."""
        return self.soft_scale if self.mode == "soft" else 0.0

    @property
    def kept_factor(self) -> float:
        """What a kept candidate's opacity is multiplied by."""
        if not self.compensate:
            return 1.0
        return (1 - self.dropped_factor / self.candidate_factor) / (1 - 1 / self.candidate_factor)

    def opacity_factors(
        self, ctx: StepContext, state: Ranking | None
    ) -> tuple[Tensor | None, Ranking]:
        import torch

        ranking = state
        if ranking is None or self._outdated(ranking, ctx):
            ranking = self._rank(ctx)
        total = len(ctx.gaussians)
        candidates = self._candidates(ranking, ctx)
        if len(candidates) == 0:
            return None, ranking
        draws = ctx.rng("uar").random(len(candidates))
        dropped = torch.from_numpy(draws < 1 / self.candidate_factor)
        factors = torch.ones(total, dtype=torch.float32)
        factors[candidates] = torch.where(dropped, self.dropped_factor, self.kept_factor).float()
        return factors, ranking

    def expected_factors(self, ctx: StepContext, state: Ranking | None) -> Tensor:
        import torch

        fits = state is not None and state.version == ctx.version  # nothing was added or removed
        ranking = state if state is not None and fits else self._rank(ctx)
        factors = torch.ones(len(ctx.gaussians))
        dimming = (1 - self.dropped_factor) / self.candidate_factor
        factors[self._candidates(ranking, ctx)] = 1 - dimming
        return factors

    def _candidates(self, ranking: Ranking, ctx: StepContext) -> Tensor:
        """Who may be dropped now: the least uncertain."""
        share = self.candidate_factor * self.drop_rate(ctx.progress)
        return ranking.order[: round(share * len(ctx.gaussians))]

    def _outdated(self, ranking: Ranking, ctx: StepContext) -> bool:
        return ranking.version != ctx.version or ctx.step - ranking.step >= self.refresh

    def _rank(self, ctx: StepContext) -> Ranking:
        """Rank the Gaussians by their uncertainty after all training views."""
        import torch

        from framework.fisher.scores import uncertainty

        first_view, *views = ctx.views
        first = ctx.fisher(first_view.camera, mask=first_view.mask)
        blocks, visible = first.block.double(), first.visible
        del first  # one at a time, and sums in place: new memory takes longer than the sums
        for view in views:
            information = ctx.fisher(view.camera, mask=view.mask)
            blocks += information.block
            visible |= information.visible
            del information
        if self.form == "diagonal":
            blocks = blocks * torch.eye(blocks.shape[-1])
        scores = uncertainty(blocks, visible, ctx.extent, self.regulariser)
        order = torch.argsort(scores, stable=True)
        order = order[: int(torch.isfinite(scores).sum())]
        ctx.log("uar_ranked", len(order))
        return Ranking(order, ctx.step, ctx.version)
