"""The evidence of view-dependent colour, per Gaussian: its gain and its cost.

A pixel is linear in a Gaussian's colour: with a_v the sum over view v's pixels of its squared
weight, y_v the SH basis above degree 0 in the direction of v and b a channel's coefficients, a
colour (s + y_v b) with a free mean s fits the views better than a constant by

    G = 1 / (2 s2) sum_v a_v ((y_v - y) b)^2,    y = sum_v a_v y_v / sum_v a_v

(at an optimum, see `capacity=evidence`; s takes up the mean y b, so only differences count)
and costs, with b a priori from N(0, q I) and s from a flat prior, both sums over the channels,

    C = 1/2 log det(I + q / s2 sum_v a_v (y_v - y)^T (y_v - y)) + log 2.

So with three views the cost is of at most two directions, for any number of coefficients.
Gains hold one at a time: many Gaussians that lose their bands together lose more.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from framework.compute import portable
from framework.kernels.reference import sh_basis
from framework.types import Gaussians

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BandsEvidence:
    """gain, cost: [M] nats. sh0: [M, 3], the best coefficients
    without bands."""

    gain: Array
    cost: Array
    sh0: Array


def prior_variance(gaussians: Gaussians) -> float:
    """q: the mean square of all coefficients above degree 0."""
    return float(np.square(gaussians.shN.double().numpy()).mean())


def bands_evidence(
    gaussians: Gaussians, centers: Sequence[Tensor], colours: Sequence[Tensor], noise: float
) -> BandsEvidence:
    """Compute the evidence of the M > 0 Gaussians that have SH bands above 0.

    Args:
        centers: [3] of every view's camera.
        colours: [N, 3], every view's information on the three coefficients of sh0, at unit noise:
            a_v / (4 pi), 0 where the colour is clamped.
        noise: the variance s2.
    """
    m, degree = len(gaussians.shN), gaussians.sh_degree
    coefficients = gaussians.shN.double().numpy()  # [M, K - 1, 3]
    basis = np.stack([_basis(gaussians.means[:m], center, degree) for center in centers], 1)
    weights = np.stack([colour[:m].double().numpy() for colour in colours], 1) * 4 * np.pi
    spread, y0 = prior_variance(gaussians), np.sqrt(1 / (4 * np.pi))
    gain, cost = np.zeros(m), np.full(m, math.log(2))
    sh0 = gaussians.sh0[:m, 0].double().numpy().copy()
    for channel in range(3):
        rows, mean = _centred(basis, weights[:, :, channel])
        sh0[:, channel] += (mean * coefficients[:, :, channel]).sum(1) / y0
        change = portable.product(rows, coefficients[:, :, channel, None])[..., 0]
        gain += np.square(change).sum(1) / (2 * noise)
        small = rows if rows.shape[1] <= rows.shape[2] else rows.transpose(0, 2, 1)
        gram = portable.product(small, small.transpose(0, 2, 1)) * (spread / noise)
        cost += 0.5 * portable.log_det(np.eye(gram.shape[1]) + gram)
    return BandsEvidence(gain, cost, sh0)


def _centred(basis: Array, weights: Array) -> tuple[Array, Array]:
    """sqrt(a_v) (y_v - y) [M, V, K - 1] and y [M, K - 1] from the y_v and the a_v [M, V]."""
    total = np.maximum(weights.sum(1), np.finfo(np.float64).tiny)
    mean = (weights[:, :, None] * basis).sum(1) / total[:, None]
    centred: Array = np.sqrt(weights)[:, :, None] * (basis - mean[:, None])
    return centred, mean


def _basis(means: Tensor, center: Tensor, degree: int) -> Array:
    """[M, K - 1] the basis above degree 0 as seen from `center`."""
    directions = torch.nn.functional.normalize(means.double() - center, dim=1)
    rows: Array = sh_basis(directions, degree)[:, 1:].numpy()
    return rows
