"""Plain numpy twins of the plane-sweep kernels: what those must compute, slowly and readably.
`init=epipolar`, which has few windows, takes `zncc` from here.

Same layouts and units as `match`, `aggregate` and `select`; float64, whole volumes at once.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, uniform_filter

from framework.depth.matching.match import COST_ONE, VARIANCE_FLOOR

Array = NDArray[np.float64]


def zncc(a: Array, b: Array, radius: int) -> Array:
    """[H, W] zero-mean normalised cross-correlation of the windows of two images, borders repeated,
    with `VARIANCE_FLOOR` added to both variances."""
    size = 2 * radius + 1

    def mean(values: Array) -> Array:
        result: Array = uniform_filter(values, size, mode="nearest")
        return result

    mean_a, mean_b = mean(a), mean(b)
    variance_a = np.maximum(mean(a * a) - mean_a**2, 0) + VARIANCE_FLOOR
    variance_b = np.maximum(mean(b * b) - mean_b**2, 0) + VARIANCE_FLOOR
    return (mean(a * b) - mean_a * mean_b) / np.sqrt(variance_a * variance_b)


def match_costs(
    image: Array,
    sources: Sequence[Array],
    A: Array,
    t: Array,
    inverse_depths: Array,
    radius: int,
    n_best: int,
) -> Array:
    """[H, D, W] mean of the `n_best` lowest costs, in units of 1 / COST_ONE, not rounded."""
    height, width = image.shape
    y, x = np.mgrid[:height, :width] + 0.5
    pixels = np.stack([x, y, np.ones_like(x)])
    cost = np.empty((height, len(inverse_depths), width))
    for d, q in enumerate(inverse_depths):
        scores = []
        for source, transfer, offset in zip(sources, A, t, strict=True):
            u, v, z = np.einsum("ij,jyx->iyx", transfer, pixels) + (q * offset)[:, None, None]
            u, v = u / z - 0.5, v / z - 0.5
            rows, columns = source.shape
            seen = (z > 0) & (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
            warped = map_coordinates(source, [v, u], order=1, mode="nearest")
            scores.append(np.where(seen, np.clip(1 - zncc(image, warped, radius), 0, 1), 1.0))
        cost[:, d] = np.sort(scores, axis=0)[:n_best].mean(0)
    return COST_ONE * cost


def aggregate_path(
    cost: NDArray[np.int64], penalty: NDArray[np.int64], small: int
) -> NDArray[np.int64]:
    """Costs [N, D, M] accumulated along the first axis; penalty [N, M] from one entry before."""
    total = np.empty_like(cost)
    total[0] = cost[0]
    for n in range(1, len(cost)):
        before = total[n - 1]
        padded = np.pad(before, ((1, 1), (0, 0)), constant_values=2**30)
        low = before.min(0)
        steps = [before, padded[:-2] + small, padded[2:] + small]
        steps.append(np.broadcast_to(low + penalty[n], before.shape))
        total[n] = cost[n] + np.min(steps, axis=0) - low
    return total


def aggregate(
    cost: NDArray[np.int16], penalty_x: NDArray[np.int16], penalty_y: NDArray[np.int16], small: int
) -> NDArray[np.int64]:
    """[H, D, W] sum over the four paths, exact integers."""
    volume = cost.astype(np.int64)
    total = np.zeros_like(volume)
    for axis, penalty in ((2, penalty_x), (0, penalty_y)):
        moved = np.moveaxis(volume, axis, 0) if axis == 0 else volume.transpose(2, 1, 0)
        between = penalty.astype(np.int64) if axis == 0 else penalty.T.astype(np.int64)
        # seen from behind, the penalty before an entry is the one that stood after it
        behind = np.roll(between, -1, 0)[::-1]
        there = aggregate_path(moved, between, small)
        back = aggregate_path(moved[::-1], behind, small)[::-1]
        total += there + back if axis == 0 else (there + back).transpose(2, 1, 0)
    return total


def select_planes(total: NDArray[np.int16]) -> Array:
    """[H, W] plane index of the lowest total, with the parabola's shift."""
    planes = total.shape[1]
    winner = total.argmin(1)
    inner = np.clip(winner, 1, planes - 2)[:, None]
    below, lowest, above = (
        np.take_along_axis(total, inner + step, 1)[:, 0].astype(np.float64) for step in (-1, 0, 1)
    )
    curvature = below - 2 * lowest + above
    bends = (winner == inner[:, 0]) & (curvature > 0)
    return winner + np.where(bends, 0.5 * (below - above) / np.where(bends, curvature, 1), 0.0)
