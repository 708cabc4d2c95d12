"""Each plane-sweep kernel against its plain numpy twin."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from framework.compute.parallel import run_blocks
from framework.compute.rng import stream
from framework.depth.matching.aggregate import aggregate_columns, aggregate_rows, select_planes
from framework.depth.matching.match import COST_ONE
from framework.depth.matching.sweep import cost_volume, grey, zncc
from framework.depth.transfer import pixel_transfer
from tests.depth.plane import plane_scene

Array = NDArray[np.float64]


def matched(
    image: Array, sources: list[Array], A: Array, t: Array, planes: Array, radius: int, n_best: int
) -> Array:
    """[H, D, W] mean of the lowest costs over inverse depths, not rounded."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]] + 0.5
    pixels, cost = np.stack([x, y, np.ones_like(x)]), []
    for q in planes:
        scores = []
        for source, transfer, offset in zip(sources, A, t, strict=True):
            u, v, z = np.einsum("ij,jyx->iyx", transfer, pixels) + (q * offset)[:, None, None]
            u, v = u / z - 0.5, v / z - 0.5
            rows, columns = source.shape
            seen = (z > 0) & (u >= 0) & (v >= 0) & (u <= columns - 1) & (v <= rows - 1)
            warped = map_coordinates(source, [v, u], order=1, mode="nearest")
            scores.append(np.where(seen, np.clip(1 - zncc(image, warped, radius), 0, 1), 1.0))
        cost.append(np.sort(scores, axis=0)[:n_best].mean(0))
    return COST_ONE * np.stack(cost, axis=1)


def path(cost: np.ndarray, penalty: np.ndarray, small: int) -> np.ndarray:
    """Costs [N, D, M] accumulated along the first axis; penalty [N, M] from one entry before."""
    total = cost.copy()
    for n in range(1, len(cost)):
        before = total[n - 1]
        padded = np.pad(before + small, ((1, 1), (0, 0)), constant_values=2**30)
        low = before.min(0)
        jump = np.broadcast_to(low + penalty[n], before.shape)
        total[n] += np.min([before, padded[:-2], padded[2:], jump], axis=0) - low
    return total


def aggregated(cost: np.ndarray, across: np.ndarray, down: np.ndarray, small: int) -> np.ndarray:
    """[H, D, W] sum over the four paths, exact integers."""
    volume, total = cost.astype(np.int64), 0
    for axis, penalty in ((2, across.T), (0, down)):
        moved, between = volume.swapaxes(0, axis), penalty.astype(np.int64)
        # seen from behind, the penalty before an entry is the one that stood after it
        behind = np.roll(between, -1, 0)[::-1]
        both = path(moved, between, small) + path(moved[::-1], behind, small)[::-1]
        total = total + both.swapaxes(0, axis)
    return np.asarray(total)


def selected(total: np.ndarray) -> Array:
    """[H, W] plane index of the lowest total, with the parabola's shift."""
    winner = total.argmin(1)
    inner = np.clip(winner, 1, total.shape[1] - 2)
    below, lowest, above = (
        np.take_along_axis(total, (inner + step)[:, None], 1)[:, 0].astype(float)
        for step in (-1, 0, 1)
    )
    curvature = below - 2 * lowest + above
    bends = (winner == inner) & (curvature > 0)
    return winner + np.where(bends, 0.5 * (below - above) / np.where(bends, curvature, 1), 0.0)


@pytest.mark.parametrize(("sources", "radius"), [([1, 2], 3), ([0, 1, 1, 0], 1), ([2], 2)])
def test_match_costs_equal_the_reference(sources: list[int], radius: int) -> None:
    views = plane_scene().views
    index = 0 if 0 not in sources else 2
    images = [grey(v) for v in views]
    near, far = 4.0, 7.0
    cost = cost_volume(views, images, index, sources, (near, far), 7, radius)
    transfers = [pixel_transfer(views[index].camera, views[s].camera) for s in sources]
    expected = matched(
        images[index].astype(np.float64),
        [images[s].astype(np.float64) for s in sources],
        np.stack([a for a, _ in transfers]),
        np.stack([b for _, b in transfers]),
        np.linspace(1 / far, 1 / near, 7),
        radius,
        max(1, len(sources) // 2),
    )
    error = np.abs(cost - expected)
    # float32 coordinates put a few pixels on the other side of an image border
    assert np.quantile(error, 0.999) < 0.002 * COST_ONE
    assert np.median(error) <= 1


@pytest.mark.parametrize("shape", [(9, 5, 40), (17, 33, 70), (3, 4, 1), (1, 3, 20)])
def test_aggregation_equals_the_reference_exactly(shape: tuple[int, int, int]) -> None:
    rng = stream(3, "tests/depth/aggregation")
    height, _, width = shape
    cost = rng.integers(0, COST_ONE + 1, shape).astype(np.int16)
    penalties = [rng.integers(400, COST_ONE + 1, (height, width)).astype(np.int16) for _ in "xy"]
    total = np.empty_like(cost)
    run_blocks(aggregate_rows, cost, penalties[0], np.int16(400), total)
    run_blocks(aggregate_columns, cost, penalties[1], np.int16(400), total)
    np.testing.assert_array_equal(total, aggregated(cost, *penalties, 400))


def test_the_worst_costs_and_penalties_do_not_overflow() -> None:
    cost = np.full((40, 5, 40), COST_ONE, np.int16)
    cost[::2, 0, ::2] = 0
    penalty = np.full((40, 40), COST_ONE, np.int16)
    total = np.empty_like(cost)
    run_blocks(aggregate_rows, cost, penalty, np.int16(COST_ONE), total)
    run_blocks(aggregate_columns, cost, penalty, np.int16(COST_ONE), total)
    np.testing.assert_array_equal(total, aggregated(cost, penalty, penalty, COST_ONE))


def test_selection_equals_the_reference() -> None:
    rng = stream(4, "tests/depth/selection")
    total = rng.integers(0, 20, (6, 9, 31)).astype(np.int16)
    position, zncc = np.empty((6, 31), np.float32), np.empty((6, 31), np.float32)
    run_blocks(select_planes, total, total, position, zncc)
    np.testing.assert_allclose(position, selected(total), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(zncc, 1 - total.min(1) / COST_ONE, rtol=1e-6)
