"""`capacity=evidence`: add and prune Gaussians and SH bands by their Bayesian evidence.

A Gaussian, or its SH bands above 0 (`framework.toolbox.bands`), is removed unless it raises the
evidence of the training photos.

Derivation. Pixels are image + noise of variance s2. With parameters a priori from N(m, diag(v)),
the Laplace approximation of the evidence (MacKay 1992) with Gaussian i over that without is

    log Z_i / Z_0 = G_i - C_i,    G_i = log-likelihood with it - without it,
    C_i = 1/2 log det(I + V^(1/2) F_i V^(1/2) / s2) + log 2,

with F_i its Fisher information of all training views for unit noise. The cost is half the
log-determinant, relative to the prior spread v, plus one bit for its existence. Pixels are linear
in one Gaussian's opacity. So at an optimum, where residuals are orthogonal to their change by it,
G_i = E_i / (2 s2), with E_i the squared change of the images without it (`scores.removal_energy`).
The noise s2 is the mean squared residual of the training pixels, at least that of 8-bit images; v
is the spread of the current Gaussians (empirical Bayes). So there are no parameters to set.

Approximations:
- Gaussians are independent: the others are not refitted when one is removed. `G_i` is too large
  then, and too many stay. Rounds with training between them compensate for it.
- `F_i` is the 6x6 block of mean and log-scale and a diagonal.
- The residuals' effect on prior means and their correlation are left out. `correlated` counts
  the channels' correlation. Scaling `G` by that of neighbouring pixels too removes the scene, see
  `benchmarks/results/capacity.md`.

Growth proposes Gaussians (those with the largest gradient are split), evidence decides. Errors that
training has not fixed yet count as noise, and new Gaussians are not yet at their optimum. Both
remove too much. Therefore:
- The first round is at `start`, until which the trainer uses small images
  (`trainer.coarse_until`). Without detail 19 of 20 Gaussians would be removed.
- A round removes at most `pace` of the Gaussians, those with the least gain first, as gains hold
  one at a time. It removes more where k Gaussians together lower the evidence even if all of them
  change the same pixels in the same direction. Their change is then at most k times the sum of
  their energies (Cauchy-Schwarz).
- With many views few epochs lie between rounds. Below ten the pace falls with their number. It
  falls with its square root once nothing grows and rates fall. Rounds are
  at least `APART` epochs apart (a round costs about two epochs).

`start`, `pace` and `until` were chosen by experiment, see `benchmarks/results/capacity.md`.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from framework.plugin import StepContext, register
from framework.toolbox.rounds import SH0, RoundsCapacity, Selection, TrainingInformation

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from torch import Tensor

    from framework.fisher.information import FisherInformation
    from framework.types import Gaussians

    Array = NDArray[np.float64]

log = logging.getLogger(__name__)

CRITERIA = ("laplace", "correlated", "bic")
APART = 2  # epochs from one round to the next at least, if a round comes at all
FEWEST, HANDFUL = 8, 16  # always kept; a warning is given at this number
ROUNDING_VARIANCE = (1 / 255) ** 2 / 12  # of 8-bit images
NORMAL_QUARTILES = 1.3489795  # interquartile range of N(0, 1)


@register("capacity", "evidence")
@dataclass(frozen=True)
class Evidence(RoundsCapacity):
    """criterion: "laplace", as derived, "correlated" or "bic". The second is the same with the
    residuals' correlation between the colour channels; with "bic" the cost is k/2 log(number of
    pixel values) for k parameters (Schwarz 1978). pace: share of the Gaussians that a round removes
    at most. It is that of a round ten epochs after the one before; sooner, less. A larger one keeps
    fewer, for less PSNR (`benchmarks/results/capacity.md`).
    """

    defaults: ClassVar[dict[str, float]] = {"start": 0.25, "stop": 0.75}

    criterion: str = "laplace"
    pace: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("criterion", self.criterion in CRITERIA, f"one of {', '.join(CRITERIA)}")
        self.check("pace", 0 < self.pace <= 1, "a share in (0, 1]")

    def splits_again(self, ctx: StepContext) -> bool:
        return self.growing(ctx)  # the last round only drops

    def selected(self, ctx: StepContext, known: TrainingInformation) -> Selection:
        import torch

        noise, values = self._noise(ctx)
        gain, cost = self._evidence(ctx.gaussians, known, noise, values)
        unpaid = gain <= cost
        n, gone = len(gain), removable(gain, cost, self._pace(ctx))
        gone = gone[: max(0, n - FEWEST)]
        ctx.log("unpaid", float(unpaid.sum()))
        if n - len(gone) <= HANDFUL < n:  # warn once, when the number falls below
            log.warning(
                "capacity=evidence: almost no Gaussian raises the evidence, because the training"
                " views show little but the background colour; a few are kept",
            )
        keep = torch.ones(n, dtype=torch.bool)
        keep[torch.from_numpy(gone)] = False
        n_kept, n_paid = n - len(gone), n - int(unpaid.sum())
        if self.growing(ctx):
            return Selection(keep, min(round(self.grow * n_kept), n_paid))
        bands, sh0 = self._bands(ctx, known, noise, values)
        if bands is not None:
            ctx.log("bands_dropped", float((keep & ~bands)[: len(ctx.gaussians.shN)].sum()))
        return Selection(keep, 0, bands, sh0)

    def _interval(self, ctx: StepContext) -> int:
        first = max(1, math.floor(self.until * ctx.n_steps))
        return max(super()._interval(ctx), min(APART * len(ctx.views), first))

    def _pace(self, ctx: StepContext) -> float:
        """The share that a round may remove, with so many views."""
        settled = self.settled(ctx)
        return self.pace * (settled if self.growing(ctx) else math.sqrt(settled))

    def _noise(self, ctx: StepContext) -> tuple[float, float]:
        """(s2 as the criterion takes it, number of training values)."""
        noise, values, channels = residual_noise(ctx)
        ctx.log("noise", math.sqrt(noise))
        return noise * channels if self.criterion == "correlated" else noise, values

    def _evidence(
        self, gaussians: Gaussians, known: TrainingInformation, noise: float, values: float
    ) -> tuple[Array, Array]:
        """(G, C), each [N] nats."""
        import numpy as np

        from framework.fisher.scores import removal_energy

        energy = removal_energy(known.total.diagonal, gaussians.opacity_logits).numpy()
        if self.criterion == "bic":
            size = np.full(len(energy), 14.0)
            size[: len(gaussians.shN)] += 3 * gaussians.shN.shape[1]
            cost = 0.5 * size * math.log(values)
        else:
            cost = description_cost(gaussians, known.total, noise)
        return energy / (2 * noise), cost

    def _bands(
        self, ctx: StepContext, known: TrainingInformation, noise: float, values: float
    ) -> tuple[Tensor | None, Tensor | None]:
        """(whose SH bands pay [N] bool, sh0 with the mean colour of those whose do not); None where
        none go. Judged when nothing grows any more and all bands are in use, as what they gain is
        learned slowly; all that do not pay go at once."""
        import numpy as np
        import torch

        from framework.toolbox.bands import bands_evidence

        gaussians = ctx.gaussians
        if not 0 < gaussians.sh_degree == ctx.sh_degree:
            return None, None
        centers = [view.camera.center for view in ctx.views]
        found = bands_evidence(gaussians, centers, known.colours, noise)
        cost = found.cost
        if self.criterion == "bic":
            cost = np.full(len(cost), 1.5 * gaussians.shN.shape[1] * math.log(values))
        pays = torch.zeros(len(gaussians), dtype=torch.bool)
        pays[: len(cost)] = torch.from_numpy(found.gain > cost)
        gone = torch.from_numpy(found.gain <= cost)
        if not gone.any():
            return None, None
        sh0 = gaussians.sh0.clone()
        sh0[: len(gone)][gone] = torch.from_numpy(found.sh0).to(sh0)[gone][:, None]
        return pays, sh0


def residual_noise(ctx: StepContext) -> tuple[float, float, float]:
    """Measure the residuals of all valid training pixels.

    Returns:
        Their variance, the number of their values, and the factor (1 to 3) by which correlated
        channels count less than independent ones.
    """
    import numpy as np

    products, pixels = np.zeros((3, 3)), 0.0
    for view in ctx.views:
        residual = (ctx.render(view.camera).rgb - view.image).numpy().astype(np.float64)
        mask = None if view.mask is None else view.mask.numpy()
        products += channel_products(residual, mask)
        pixels += residual[0].size if mask is None else float(mask.sum(dtype=np.float64))
    total = float(np.trace(products))
    variance = max(total / (3 * pixels), ROUNDING_VARIANCE)
    together = float(products.sum()) / total if total > 0 else 1.0
    return variance, 3 * pixels, min(max(together, 1.0), 3.0)


def channel_products(residual: Array, mask: Any) -> Array:
    """[3, 3] the sums over the pixels, weighted by mask [H, W] if there is one, of the products of
    the channels of residual [3, H, W]."""
    import numpy as np

    sums, pair = np.empty((3, 3)), np.empty_like(residual[0])
    for i in range(3):
        for j in range(i, 3):
            np.multiply(residual[i], residual[j], out=pair)
            if mask is not None:
                pair *= mask
            sums[i, j] = sums[j, i] = pair.sum()
    return sums


def description_cost(gaussians: Gaussians, information: FisherInformation, noise: float) -> Array:
    """C [N] in nats, at noise variance `noise`. Higher SH bands count as if seen from everywhere,
    where the addition theorem makes a coefficient's mean information that of sh0."""
    import numpy as np

    from framework.compute.portable import log1p, log_det
    from framework.toolbox.bands import prior_variance

    g = gaussians
    columns = (g.means, g.log_scales, g.quats, g.opacity_logits[:, None], g.sh0[:, 0])
    prior = np.concatenate([_spread(column) for column in columns])
    known = information.diagonal.double().numpy() * prior / noise
    root = np.sqrt(prior[:6])
    block = information.block.double().numpy() * np.outer(root, root) / noise
    logs = log_det(block + np.eye(6)) + log1p(known[:, 6:]).sum(1)
    if g.sh_degree > 0:
        higher = information.diagonal[: len(g.shN), SH0:].double().numpy() / noise
        each = log1p(higher * prior_variance(g)).sum(1)
        logs[: len(g.shN)] += g.shN.shape[1] * each
    cost: Array = 0.5 * logs + math.log(2)
    return cost


def _spread(column: Tensor) -> Array:
    """Return [P] variances of normal distributions with the quartiles of these [N, P] values.

    Their mean over all P is used, so the result does not depend on the world's axes.
    """
    import numpy as np

    low, high = np.quantile(column.double().numpy(), (0.25, 0.75), axis=0)
    return np.full(column.shape[1], np.mean(((high - low) / NORMAL_QUARTILES) ** 2))


def removable(gain: Array, cost: Array, pace: float) -> NDArray[np.int64]:
    """Choose which of N Gaussians to remove now, least gain first.

    At most a share `pace` of all, or as many as lower the evidence together in the worst case.
    """
    import numpy as np

    order = np.argsort(gain, kind="stable")
    order = order[gain[order] <= cost[order]]
    numbers = np.arange(1, len(order) + 1)
    together = numbers * np.cumsum(gain[order]) <= np.cumsum(cost[order])
    worst_case = int(numbers[together].max(initial=0))
    return order[: max(worst_case, round(pace * len(gain)))]
