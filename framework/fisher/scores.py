"""Scores from Fisher information: how new a camera is to a view, how uncertain a Gaussian is.

N Gaussians, P parameters each; information is J^T J per unit of noise variance, non-negative.
Regularisers are relative: a share of the median positive diagonal of a parameter, which acts as a
Gaussian prior shared by all Gaussians (and views). So neither the unit of length nor the brightness
of the images matters. An absolute one does not work: with the 1e-6 that is common in the field,
the trace below counts little but the parameters that the reference does not see.

All sums are numpy's, in float64 and on one thread: the bits do not depend on the thread count.
"""

from __future__ import annotations

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
    """[P] float64 prior precision lambda for the comparison of several views.

    diagonals: one [N, P] per view. Returns `regulariser` x the median positive entry of all views,
    per parameter. Raises ValueError on a regulariser that is not positive or values not finite.
    """
    _check_positive("shared_prior: regulariser", regulariser)
    return from_numpy(_prior([_float64(diagonal) for diagonal in diagonals], regulariser))


def information_gains(
    candidate: Tensor, references: Sequence[Tensor], prior: Tensor, form: str = "trace"
) -> list[float]:
    """What a candidate view would add to each of several reference views under one prior.

    candidate: [N, P] diagonal H'. references: the views' diagonals H. prior: [P] lambda > 0.
    form "log": 1/2 sum log(1 + H' / (H + lambda)), the entropy difference of the two posteriors
    (Kirsch & Gal, "Unifying approaches in active learning", 2022); form "trace": its upper bound
    1/2 sum H' / (H + lambda).

    Or all Gaussians' blocks H', H [N, D, D] with a prior [D] (see `block_prior`): summed over the
    Gaussians, "log" is 1/2 (log det(H + H' + Lambda) - log det(H + Lambda)) and "trace"
    1/2 tr(H' (H + Lambda)^-1), with

        Lambda = diag(lambda) + NOISE diag(H + H')    of each Gaussian, the same in both terms.

    The second part is what float32 derivatives leave unknown: without it a direction that no view
    sees, where H is rounding alone, would count as known. It is no detail where lambda is small:
    a Gaussian whose diagonal is 1 / NOISE times lambda has half its floor from it, and with a
    regulariser of 1e-3 it moves gains by up to 45 %. Diagonals need none.

    Raises ValueError on an unknown form, differing shapes and values that are not finite.
    """
    _check_form(form)
    for reference in references:
        _check_shapes(candidate, reference)
    if candidate.ndim == 2:
        return gains_over(candidate, [variances(known, prior) for known in references], form)
    gained = _float64(candidate)
    return [_block_gain(gained, _float64(known), prior.numpy(), form) for known in references]


def variances(diagonal: Tensor, prior: Tensor) -> Tensor:
    """[N, P] float64 (H + lambda)^-1: what a view with the diagonal H [N, P] leaves unknown."""
    return from_numpy(1 / (_float64(diagonal) + prior.numpy()))


def gains_over(candidate: Tensor, unknown: Sequence[Tensor], form: str = "trace") -> list[float]:
    """`information_gains` of diagonals from the views' `variances`, kept by who asks repeatedly."""
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


def _block_gain(gained: np.ndarray, known: np.ndarray, prior: np.ndarray, form: str) -> float:
    """1/2 sum tr(H' (H + Lambda)^-1), or the difference of the log determinants; for Lambda see
    `information_gains`."""
    floor = _floor(known + gained, prior)
    if form == "log":
        return 0.5 * float(np.sum(_log_det(known + gained, floor) - _log_det(known, floor)))
    lambdas = floor[:, :, None] * np.eye(prior.shape[0])
    return 0.5 * float(np.sum(portable.inverses(known + lambdas) * gained))


def block_prior(blocks: Sequence[Tensor], regulariser: float) -> Tensor:
    """Return the [6] float64 prior precision for blocks [N, 6, 6] of several views.

    It is `regulariser` x the median positive diagonal, one number for the means and one for the
    log-scales, so that results do not depend on the world's axes. Raises ValueError as
    `shared_prior`.
    """
    _check_positive("block_prior: regulariser", regulariser)
    return from_numpy(_block_prior(np.concatenate([_float64(b) for b in blocks]), regulariser))


def removal_energy(diagonal: Tensor, opacity_logits: Tensor) -> Tensor:
    """Return [N] float64: the squared change of the images if a Gaussian is removed, in
    intensity^2.

    diagonal: [N, 14], `FisherInformation.diagonal`, summed over the views. opacity_logits: [N].

    A pixel's colour is linear in each alpha, and alpha in the opacity o. So the change is
    o dC/do = dC/d(logit) / (1 - o) and its energy F_logit / (1 - o)^2. It is exact except at
    cut-offs: alphas clamped at 0.99 are missing, at most the central 2 % of a Gaussian's square.
    The other Gaussians are not refitted.
    """
    transparency = 1 / (1 + portable.exp(np.minimum(_float64(opacity_logits), LARGEST_LOGIT)))
    return from_numpy(_float64(diagonal)[:, OPACITY] / transparency**2)


def uncertainty(blocks: Tensor, visible: Tensor, extent: float, regulariser: float) -> Tensor:
    """U = -log det(S F S + Lambda) of every Gaussian, PUP-3DGS's score with its sign reversed.

    blocks: [N, 6, 6] information F about (mean, log-scale), summed over the training views.
    visible: [N] bool, seen by any of them. extent: scene units; S = diag(extent x 3, 1 x 3) makes
    the means dimensionless. Lambda is diagonal: `regulariser` x the median positive diagonal of the
    visible Gaussians, one number for the means and one for the log-scales (so that U is invariant
    to rigid motion). It keeps the determinant positive where few views leave F singular: one view
    alone gives rank 5 at most. NOISE x each diagonal is added, so that the sixth direction counts
    as unknown and not as what rounding left in it.

    Returns [N] float64; +inf for Gaussians that no view sees. Raises ValueError on bad input.
    """
    _check_positive("uncertainty: extent", extent)
    _check_positive("uncertainty: regulariser", regulariser)
    seen = visible.numpy().astype(bool)
    scores = np.full(seen.shape, np.inf)
    if seen.any():
        scale = np.array([extent, extent, extent, 1.0, 1.0, 1.0])
        normalised = _float64(blocks)[seen] * (scale[:, None] * scale)
        prior = _floor(normalised, _block_prior(normalised, regulariser))
        scores[seen] = -_log_det(normalised, prior)
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


def _log_det(blocks: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """[N] log det(F + diag(prior)), positive semi-definite F [N, D, D], prior [N, D], by the
    pivots of L D L^T.

    The Schur complements of F are non-negative, so no pivot of the sum is below its prior; rounding
    that says otherwise is corrected.
    """
    size = prior.shape[1]
    # [D, D, N]: one Gaussian per lane; a copy, also of one Gaussian's, which would be contiguous
    a = np.array(np.moveaxis(blocks, 0, -1), order="C")
    total = np.zeros(blocks.shape[0])
    for i in range(size):
        pivot = np.maximum(a[i, i] + prior[:, i], prior[:, i])
        total += portable.log(pivot)
        for row in range(i + 1, size):
            factor = a[row, i] / pivot
            for col in range(i + 1, row + 1):
                a[row, col] -= factor * a[col, i]
    return total


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
