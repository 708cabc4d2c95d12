"""Each plane-sweep kernel against its plain numpy twin."""

import numpy as np
import pytest

from framework.compute.parallel import run_blocks
from framework.compute.rng import stream
from framework.depth.matching import reference
from framework.depth.matching.aggregate import aggregate_columns, aggregate_rows, select_planes
from framework.depth.matching.match import COST_ONE
from framework.depth.matching.sweep import cost_volume, grey
from framework.depth.providers import PlaneSweep
from framework.depth.transfer import pixel_transfer
from tests.depth.plane import plane_scene


@pytest.mark.parametrize(("sources", "radius"), [([1, 2], 3), ([0, 1, 1, 0], 1), ([2], 2)])
def test_match_costs_equal_the_reference(sources: list[int], radius: int) -> None:
    views = plane_scene().views
    index = 0 if 0 not in sources else 2
    images = [grey(v) for v in views]
    near, far, options = 4.0, 7.0, PlaneSweep(planes=7, radius=radius)
    cost = cost_volume(views, images, index, sources, (near, far), options)
    transfers = [pixel_transfer(views[index].camera, views[s].camera) for s in sources]
    expected = reference.match_costs(
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
    np.testing.assert_array_equal(total, reference.aggregate(cost, *penalties, 400))


def test_the_worst_costs_and_penalties_do_not_overflow() -> None:
    cost = np.full((40, 5, 40), COST_ONE, np.int16)
    cost[::2, 0, ::2] = 0
    penalty = np.full((40, 40), COST_ONE, np.int16)
    total = np.empty_like(cost)
    run_blocks(aggregate_rows, cost, penalty, np.int16(COST_ONE), total)
    run_blocks(aggregate_columns, cost, penalty, np.int16(COST_ONE), total)
    np.testing.assert_array_equal(total, reference.aggregate(cost, penalty, penalty, COST_ONE))


def test_selection_equals_the_reference() -> None:
    rng = stream(4, "tests/depth/selection")
    total = rng.integers(0, 20, (6, 9, 31)).astype(np.int16)
    position, zncc = np.empty((6, 31), np.float32), np.empty((6, 31), np.float32)
    run_blocks(select_planes, total, total, position, zncc)
    np.testing.assert_allclose(position, reference.select_planes(total), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(zncc, 1 - total.min(1) / COST_ONE, rtol=1e-6)
