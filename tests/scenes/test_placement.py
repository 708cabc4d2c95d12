"""Which test cameras stand between the training cameras, by hand and by another algorithm."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import nnls

from framework.rng import stream
from framework.scenes.placement import REACH, _hull_distance, placement

SQUARE = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [2.0, 2.0, 0.0]])


def by_least_squares(points: np.ndarray) -> float:
    rows = np.vstack([points.T, np.full(len(points), 1e4)])
    weights, _ = nnls(rows, np.array([0.0, 0.0, 0.0, 1e4]))
    return float(np.linalg.norm(weights @ points) / weights.sum())


@pytest.mark.parametrize("seed", range(40))
def test_the_distance_is_that_of_a_least_squares_solver(seed: int) -> None:
    draw = stream(seed, "hull")
    points = draw.standard_normal((2 + seed % 12, 3))
    points[:, 2] += 3.0 * (seed % 3)
    assert _hull_distance(points) == pytest.approx(by_least_squares(points), rel=5e-3, abs=0.03)


def test_a_camera_interpolates_within_a_quarter_of_a_spacing() -> None:
    reach = 2.0 * REACH
    centers = np.array(
        [[1.0, 1.0, 0.9 * reach], [1.0, 1.0, 1.1 * reach], [2.4, 1.0, 0.0], [2.6, 1.0, 0.0]]
    )
    inside, outside = ("interpolating",), ("extrapolating",)
    assert placement(centers, SQUARE) == [inside, outside, inside, outside]
    assert placement(centers * 7 + 5, SQUARE * 7 + 5) == [inside, outside, inside, outside]


def test_no_tag_where_no_two_training_cameras_stand_apart() -> None:
    assert placement(SQUARE, SQUARE[:1]) == placement(SQUARE, SQUARE[[1, 1]]) == [()] * 4
