"""Scores from Fisher information: how new a camera is to a view, how uncertain a Gaussian is.

There are N Gaussians with P parameters each. Information is J^T J per unit of noise variance, so it
is non-negative. Regularisers are relative: a share of the median positive diagonal of a parameter.
They act as one Gaussian prior on all Gaussians and views, so neither the unit of length nor the
brightness of the images matters. An absolute regulariser does not work: with the usual 1e-6, the
trace below depends almost only on parameters that the reference view does not see.

All sums are numpy's, in float64 and on one thread, so the bits do not depend on the thread count.
"""

from collections.abc import Sequence

import numpy as np
from torch import Tensor, from_numpy

from framework.compute import portable
from framework.errors import UserError

FORMS = ("trace", "log")
ROUNDING = 1e-12  # a parameter whose information is below this share of the largest has none
LARGEST_LOGIT = 40.0  # beyond it 1 - o has no digits left in float32
OPACITY = 10  # the opacity logit's place in a diagonal
NOISE = 1e-5  # share of its diagonal to which a block from float32 derivatives is known


def shared_prior(diagonals: Sequence[Tensor], regulariser: float) -> Tensor:
    """Return the prior precision lambda for the comparison of several views.

    Args:
        diagonals: the information [N, P] of each view.
        regulariser: share of the median.

    Returns:
        [P] float64, `regulariser` x the median positive entry of all views, for each parameter.

    Raises:
        ValueError: for a regulariser that is not positive.
        UserError: for values that are not finite.
    """
    _check_positive("shared_prior: regulariser", regulariser)
    return from_numpy(_prior([_float64(diagonal) for diagonal in diagonals], regulariser))


def information_gains(
    candidate: Tensor, references: Sequence[Tensor], prior: Tensor, form: str = "trace"
) -> list[float]:
    """Compute what a candidate view would add to each of several reference views.

    With diagonals, "log" is the difference of entropy between the two posteriors and "trace" its
    upper bound:

        log    1/2 sum log(1 + H' / (H + lambda))
        trace  1/2 sum H' / (H + lambda)

    With the blocks [N, D, D] of all Gaussians and a prior [D], both are sums over the Gaussians:

        log    1/2 (log det(H + H' + Lambda) - log det(H + Lambda))
        trace  1/2 tr(H' (H + Lambda)^-1)
        Lambda = diag(lambda) + NOISE diag(H + H')

    The second term of Lambda is the error of float32 derivatives. Without it, a direction that no
    view sees, where H is only rounding, would count as known. It matters where lambda is small: a
    Gaussian whose diagonal is lambda / NOISE has half of its floor from it, and with a regulariser
    of 1e-3 it changes gains by up to 45 %. Diagonals do not need it.

    Args:
        candidate: information H' of the candidate, [N, P] diagonals or [N, D, D] blocks.
        references: information H of each reference view, in the same form.
        prior: precision lambda > 0, [P] or [D], see `shared_prior` and `block_prior`.
        form: "trace" or "log".

    Returns:
        The gain in nats for each reference view.

    Raises:
        ValueError: for an unknown form or different shapes.
        UserError: for values that are not finite.

    Source:
        Kirsch and Gal, "Unifying approaches in active learning", 2022.
    """
    _check_form(form)
    for reference in references:
        _check_shapes(candidate, reference)
    if candidate.ndim == 2:
        return gains_over(
            candidate, [variances(available, prior) for available in references], form
        )
    gained = _float64(candidate)
    return [
        _block_gain(gained, _float64(available), prior.numpy(), form) for available in references
    ]


def variances(diagonal: Tensor, prior: Tensor) -> Tensor:
    """Return (H + lambda)^-1, [N, P] float64: what a view with diagonal H [N, P] leaves
    uncertain.
    """
    return from_numpy(1 / (_float64(diagonal) + prior.numpy()))


def gains_over(candidate: Tensor, unknown: Sequence[Tensor], form: str = "trace") -> list[float]:
    """Compute `information_gains` from the `variances` of the views, which the caller can keep."""
    _check_form(form)
    gained = _float64(candidate)
    gains = []
    for of_view in unknown:
        _check_shapes(candidate, of_view)
        left = of_view.numpy()
        if form == "trace":  # einsum: in a fixed order on one thread, without the [N, P] of ratios
            gains.append(0.5 * float(np.einsum("np,np->", gained, left)))
        else:
            gains.append(0.5 * float(np.sum(portable.log1p(gained * left))))
    return gains


def _check_form(form: str) -> None:
    if form not in FORMS:
        raise ValueError(f"information_gains: form must be one of {', '.join(FORMS)}, got '{form}'")


def _check_shapes(candidate: Tensor, reference: Tensor) -> None:
    if reference.shape != candidate.shape:
        raise ValueError(
            f"information_gains: candidate {tuple(candidate.shape)} and reference"
            f" {tuple(reference.shape)} differ"
        )


def _block_gain(gained: np.ndarray, reference: np.ndarray, prior: np.ndarray, form: str) -> float:
    """1/2 sum tr(H' (H + Lambda)^-1), or the difference of the log determinants; for Lambda see
    `information_gains`."""
    floor = _floor(reference + gained, prior)
    if form == "log":
        after, before = (portable.log_det(h, floor) for h in (reference + gained, reference))
        return 0.5 * float(np.sum(after - before))
    lambdas = floor[:, :, None] * np.eye(prior.shape[0])
    return 0.5 * float(np.sum(portable.inverses(reference + lambdas) * gained))


def block_prior(blocks: Sequence[Tensor], regulariser: float) -> Tensor:
    """Return the prior precision for blocks of several views.

    It is one number for the means and one for the log-scales, so that it does not depend on the
    axes of the world.

    Args:
        blocks: [N, 6, 6] of each view.
        regulariser: share of the median positive diagonal.

    Returns:
        [6] float64.

    Raises:
        ValueError: for a regulariser that is not positive.
        UserError: for values that are not finite.
    """
    _check_positive("block_prior: regulariser", regulariser)
    return from_numpy(_block_prior(np.concatenate([_float64(b) for b in blocks]), regulariser))


def removal_energy(diagonal: Tensor, opacity_logits: Tensor) -> Tensor:
    """Compute how much the images change if a Gaussian is removed.

    A pixel's colour is linear in each alpha, and alpha is linear in the opacity o. So the change is
    o dC/do = dC/d(logit) / (1 - o), and its energy F_logit / (1 - o)^2. This is exact except where
    alpha is clamped at 0.99, which is at most the central 2 % of a Gaussian's square. Other
    Gaussians do not fill the gap, so the loss after a refit is smaller.

    Args:
        diagonal: [N, 14], `FisherInformation.diagonal`, summed over the views.
        opacity_logits: [N].

    Returns:
        [N] float64, squared change summed over pixels and channels, in intensity^2.
    """
    transparency = 1 / (1 + portable.exp(np.minimum(_float64(opacity_logits), LARGEST_LOGIT)))
    return from_numpy(_float64(diagonal)[:, OPACITY] / transparency**2)


def uncertainty(blocks: Tensor, visible: Tensor, extent: float, regulariser: float) -> Tensor:
    """Compute U = -log det(S F S + Lambda) of every Gaussian, the negative of PUP-3DGS's score.

    S = diag(extent, extent, extent, 1, 1, 1) makes the means dimensionless. Lambda is diagonal:
    `regulariser` x the median positive diagonal of the visible Gaussians, one number for the means
    and one for the log-scales, so that U does not change under rigid motion. It keeps the
    determinant positive if few views leave F singular; one view has at most rank 5. NOISE x each
    diagonal is added, so that the sixth direction does not depend on rounding.

    Args:
        blocks: [N, 6, 6] information F on (mean, log-scale), summed over the training views.
        visible: [N] bool, seen by a training view.
        extent: of the scene, scene units.
        regulariser: share of the median.

    Returns:
        [N] float64; +inf for Gaussians that no view sees.

    Raises:
        ValueError: for an extent or regulariser that is not positive.
        UserError: for values that are not finite.
    """
    _check_positive("uncertainty: extent", extent)
    _check_positive("uncertainty: regulariser", regulariser)
    seen = visible.numpy().astype(bool)
    scores = np.full(seen.shape, np.inf)
    if seen.any():
        scale = np.array([extent, extent, extent, 1.0, 1.0, 1.0])
        normalised = _float64(blocks)[seen] * (scale[:, None] * scale)
        prior = _floor(normalised, _block_prior(normalised, regulariser))
        scores[seen] = -portable.log_det(normalised, prior)
    return from_numpy(scores)


def _block_prior(blocks: np.ndarray, regulariser: float) -> np.ndarray:
    """[6]: the same number three times for the means, then for the log-scales."""
    diagonal = np.einsum("nii->ni", blocks)
    groups = np.column_stack([diagonal[:, :3].ravel(), diagonal[:, 3:].ravel()])
    return np.repeat(_prior([groups], regulariser), 3)


def _floor(blocks: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """[N, D] prior of every Gaussian: `prior` [D], and NOISE x the diagonal of its block."""
    return prior + NOISE * np.einsum("nii->ni", blocks)


def _prior(diagonals: Sequence[np.ndarray], regulariser: float) -> np.ndarray:
    """[P]: regulariser x median of the positive entries per column, at least ROUNDING x the top.

    diagonals: [N, P] each, of which one column after the other is gathered, as all of many views
    are larger than all else in a training.

    The floor matters where a parameter has no effect and float32 derivatives leave noise, as with
    the rotation of isotropic Gaussians. Without any positive entry the prior is 1.
    """

    def median(k: int) -> float:
        column = np.concatenate([diagonal[:, k] for diagonal in diagonals])
        positive = column[column > 0]
        return float(np.median(positive)) if positive.size else 0.0

    medians = np.array([median(k) for k in range(diagonals[0].shape[1])])
    floored = np.maximum(medians, ROUNDING * medians.max())
    return np.where(floored > 0, regulariser * floored, 1.0)


def _float64(x: Tensor) -> np.ndarray:
    """`x` as float64. Raises UserError on NaN or infinity."""
    array = x.detach().numpy().astype(np.float64, copy=False)
    if not np.isfinite(array).all():
        raise UserError(
            "Fisher information: expected finite values, got NaN or infinity of a Gaussian;"
            " lower trainer.lr_scale"
        )
    return array


def _check_positive(what: str, value: float) -> None:
    if not (np.isfinite(value) and value > 0):
        raise ValueError(f"{what} must be a finite number > 0, got {value}")
