"""`capacity=evidence`: add and prune Gaussians and SH bands by Bayesian evidence.

Model. Pixels are the image plus noise of variance s2. With a prior N(m, diag(v)) of the parameters,
the Laplace approximation of the log evidence (MacKay 1992) changes by the following when Gaussian i
is added:

    log Z_i / Z_0 = G_i - C_i,    G_i = log-likelihood with it - without it,
    C_i = 1/2 log det(I + V^(1/2) F_i V^(1/2) / s2) + log 2.

F_i is its Fisher information from all training views for unit noise. The cost C_i is half the
log-determinant, relative to the prior variance v, and one bit for its existence. Pixels are linear
in the opacity of one Gaussian. At an optimum, where residuals are orthogonal to their change,
G_i = E_i / (2 s2), where E_i is the squared change of the images without it
(`scores.removal_energy`). The noise s2 is the mean squared residual of the training pixels, but at
least that of 8-bit images. v is the spread of the current Gaussians (empirical Bayes). No constant
is set by hand.

Approximations. Blocks of different Gaussians are independent: the others are not refitted when one
is removed, so G_i and the number of Gaussians are too large. Pruning in rounds with training in
between compensates for that. F_i is the 6x6 block of mean and log-scale and a diagonal.
Correlations of residuals are ignored, except that `correlated` accounts for colour channels.
Accounting for neighbouring pixels in the same way prunes the whole scene.

Growth proposes Gaussians by splitting those with the largest gradients, and evidence decides. Early
in the training two errors prune too much: residuals that training will still reduce count as noise,
and Gaussians have not reached their final gain. Therefore:

- No round comes before `start`. Until then training images are small (`trainer.coarse_until`), and
  19 of 20 Gaussians would be pruned.

- A round prunes at most the share `pace`, smallest gain first, because gains hold for one removal
  at a time. It prunes more if k Gaussians are not worth their cost even if all of them changed the
  same pixels in the same direction: they change the images by at most k times the sum of their
  energies (Cauchy-Schwarz).

- With many views few epochs lie between rounds. Below ten epochs the pace falls with their number,
  and with its square root once growth has ended. There are at least `APART` epochs between rounds,
  because a round costs about two.

`start`, `pace` and `until` were chosen by trial (docs/decisions.md).
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
FEWEST, HANDFUL = 8, 16  # always kept; a warning appears at this number
ROUNDING_VARIANCE = (1 / 255) ** 2 / 12  # of 8-bit images
NORMAL_QUARTILES = 1.3489795  # interquartile range of N(0, 1)


@register("capacity", "evidence")
@dataclass(frozen=True)
class Evidence(RoundsCapacity):
    """Prunes Gaussians and SH bands that lower the evidence.

    With "correlated" the residuals' correlation between colour channels counts. With "bic" the cost
    is k/2 log(number of pixel values) for k parameters (Schwarz 1978). A larger pace keeps fewer
    Gaussians and costs PSNR.
    """

    title: ClassVar[str] = "Evidence"
    paper: ClassVar[str] = "mackay"

    defaults: ClassVar[dict[str, float]] = {"start": 0.25, "stop": 0.75}

    criterion: str = "laplace"  # "laplace", as derived, "correlated" or "bic"
    pace: float = 0.25  # largest share that a round prunes, ten epochs after the last; else less

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check("criterion", self.criterion in CRITERIA, f"one of {', '.join(CRITERIA)}")
        self.check("pace", 0 < self.pace <= 1, "a share in (0, 1]")

    def splits_again(self, ctx: StepContext) -> bool:
        return self.growing(ctx)  # the last round only drops

    def selected(self, ctx: StepContext, information: TrainingInformation) -> Selection:
        import torch

        from framework.fisher.scores import removal_energy

        noise, values = self._noise(ctx)
        energy = removal_energy(information.total.diagonal, ctx.gaussians.opacity_logits)
        gain = energy.numpy() / (2 * noise)
        cost = self._cost(ctx.gaussians, information, noise, values)
        too_costly = gain <= cost
        n, gone = len(gain), removable(gain, cost, self._pace(ctx))
        gone = gone[: max(0, n - FEWEST)]
        ctx.log("unpaid", float(too_costly.sum()))
        if n - len(gone) <= HANDFUL < n:  # once, on the way down
            log.warning(
                "capacity=evidence: hardly any Gaussian is worth its cost: the training views"
                " show little but the background colour; a handful is kept",
            )
        keep = torch.ones(n, dtype=torch.bool)
        keep[torch.from_numpy(gone)] = False
        n_kept, n_paid = n - len(gone), n - int(too_costly.sum())
        if self.growing(ctx):
            splits = min(round(self.grow * n_kept), n_paid)
            return self.within(ctx, Selection(keep, splits), energy)
        keep = self.within(ctx, Selection(keep), energy).keep
        bands, sh0 = self._bands(ctx, information, noise, values)
        if bands is not None:
            ctx.log("bands_dropped", float((keep & ~bands)[: len(ctx.gaussians.shN)].sum()))
        return Selection(keep, 0, bands, sh0)

    def _interval(self, ctx: StepContext) -> int:
        first = max(1, math.floor(self.until * ctx.n_steps))
        return max(super()._interval(ctx), min(APART * len(ctx.views), first))

    def _pace(self, ctx: StepContext) -> float:
        """The largest share that a round may prune, given the number of views."""
        settled = self.settled(ctx)
        return self.pace * (settled if self.growing(ctx) else math.sqrt(settled))

    def _noise(self, ctx: StepContext) -> tuple[float, float]:
        """Return the noise variance s2 of the criterion and the number of training values."""
        noise, values, channels = residual_noise(ctx)
        ctx.log("noise", math.sqrt(noise))
        return noise * channels if self.criterion == "correlated" else noise, values

    def _cost(
        self, gaussians: Gaussians, information: TrainingInformation, noise: float, values: float
    ) -> Array:
        """Return the cost C [N] in nats."""
        import numpy as np

        if self.criterion != "bic":
            return description_cost(gaussians, information.total, noise)
        size = np.full(len(gaussians), 14.0)
        size[: len(gaussians.shN)] += 3 * gaussians.shN.shape[1]
        return 0.5 * size * math.log(values)

    def _bands(
        self, ctx: StepContext, information: TrainingInformation, noise: float, values: float
    ) -> tuple[Tensor | None, Tensor | None]:
        """Decide which Gaussians keep their SH bands, after growth and with all bands active.

        Returns:
            [N] bool, and sh0 with the mean colour of those that lose their bands; or None, None.
        """
        import numpy as np
        import torch

        from framework.toolbox.bands import bands_evidence

        gaussians = ctx.gaussians
        if not 0 < gaussians.sh_degree == ctx.sh_degree:
            return None, None
        centers = [view.camera.center for view in ctx.views]
        evidence = bands_evidence(gaussians, centers, information.colours, noise)
        cost = evidence.cost
        if self.criterion == "bic":
            cost = np.full(len(cost), 1.5 * gaussians.shN.shape[1] * math.log(values))
        kept = torch.zeros(len(gaussians), dtype=torch.bool)
        kept[: len(cost)] = torch.from_numpy(evidence.gain > cost)
        gone = torch.from_numpy(evidence.gain <= cost)
        if not gone.any():
            return None, None
        sh0 = gaussians.sh0.clone()
        sh0[: len(gone)][gone] = torch.from_numpy(evidence.sh0).to(sh0)[gone][:, None]
        return kept, sh0


def residual_noise(ctx: StepContext) -> tuple[float, float, float]:
    """Measure the residuals of all valid training pixels.

    Returns:
        Their variance, the number of values, and the factor, 1 to 3, by which correlated channels
        of a pixel are worth less than independent ones.
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
    """Sum the products of the channels of `residual` [3, H, W] over the (masked) pixels: [3, 3]."""
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
    """Compute the cost C [N] in nats at the noise variance `noise`.

    Higher SH bands count as if seen from all directions. By the addition theorem, the mean
    information of a coefficient then equals that of sh0.
    """
    import numpy as np

    from framework.compute.portable import log1p, log_det
    from framework.toolbox.bands import prior_variance

    g = gaussians
    columns = (g.means, g.log_scales, g.quats, g.opacity_logits[:, None], g.sh0[:, 0])
    prior = np.concatenate([_spread(column) for column in columns])
    precision = information.diagonal.double().numpy() * prior / noise
    root = np.sqrt(prior[:6])
    block = information.block.double().numpy() * np.outer(root, root) / noise
    logs = log_det(block + np.eye(6), least=1.0) + log1p(precision[:, 6:]).sum(1)
    if g.sh_degree > 0:
        higher = information.diagonal[: len(g.shN), SH0:].double().numpy() / noise
        each = log1p(higher * prior_variance(g)).sum(1)
        logs[: len(g.shN)] += g.shN.shape[1] * each
    cost: Array = 0.5 * logs + math.log(2)
    return cost


def _spread(column: Tensor) -> Array:
    """Variance [P] of normal distributions with the quartiles of `values` [N, P].

    It is averaged over P, so that it does not depend on the axes of the world.
    """
    import numpy as np

    low, high = np.quantile(column.double().numpy(), (0.25, 0.75), axis=0)
    return np.full(column.shape[1], np.mean(((high - low) / NORMAL_QUARTILES) ** 2))


def removable(gain: Array, cost: Array, pace: float) -> NDArray[np.int64]:
    """Return which of N Gaussians to prune, smallest gain first.

    At most the share `pace` of all, or as many as are not worth their cost even in the worst case.
    """
    import numpy as np

    order = np.argsort(gain, kind="stable")
    order = order[gain[order] <= cost[order]]
    numbers = np.arange(1, len(order) + 1)
    together = numbers * np.cumsum(gain[order]) <= np.cumsum(cost[order])
    worst_case = int(numbers[together].max(initial=0))
    return order[: max(worst_case, round(pace * len(gain)))]
