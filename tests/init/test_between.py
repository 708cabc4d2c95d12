"""Planes between points of an image, against SciPy's interpolation and by their laws."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import griddata

from framework.initialize.between import FEWEST_POINTS, between, draw_triangles

SHAPE = 40, 60


def some_points(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    return random.uniform([0, 0], SHAPE[::-1], (n, 2)), random.uniform(0.1, 1.0, n)


@pytest.mark.parametrize("seed", range(5))
def test_it_is_linear_in_delaunay_triangles_and_the_nearest_beyond(seed: int) -> None:
    uv, inverse = some_points(30, seed)
    found = between(uv, inverse, np.ones(SHAPE, np.bool_))
    x, y = np.meshgrid(np.arange(SHAPE[1]) + 0.5, np.arange(SHAPE[0]) + 0.5)
    linear, nearest = (griddata(uv, inverse, (x, y), how) for how in ("linear", "nearest"))
    assert found is not None
    np.testing.assert_allclose(found, np.where(np.isnan(linear), nearest, linear), rtol=1e-9)


def test_a_plane_comes_back_and_pixels_that_nobody_asks_for_stay_empty() -> None:
    uv, _ = some_points(30)
    corners = np.array([[0.0, 0], [60, 0], [0, 40], [60, 40]])
    uv, wanted = np.concatenate([uv, corners]), np.zeros(SHAPE, np.bool_)
    wanted[5:30, 10:50] = True
    found = between(uv, 0.2 + uv @ [0.01, 0.02], wanted)
    assert found is not None
    x, y = np.meshgrid(np.arange(60) + 0.5, np.arange(40) + 0.5)
    np.testing.assert_allclose(found[wanted], (0.2 + 0.01 * x + 0.02 * y)[wanted], rtol=1e-12)
    assert not found[~wanted].any()


def test_points_that_span_nothing_give_nothing() -> None:
    everywhere = np.ones(SHAPE, np.bool_)
    assert between(*some_points(FEWEST_POINTS - 1), everywhere) is None
    line = np.linspace(1, 30, 20)
    assert between(np.column_stack([line, line]), np.ones(20), everywhere) is None
    assert between(np.full((20, 2), 3.0), np.ones(20), everywhere) is None


def test_a_triangle_of_no_area_and_corners_outside_the_image_harm_nothing() -> None:
    image = np.zeros((4, 4))
    flat = np.array([[[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]]])
    draw_triangles(flat, np.ones((1, 3)), image)
    assert not image.any()
    large = np.array([[[-100.0, -100.0], [300.0, -100.0], [-100.0, 300.0]]])
    draw_triangles(large, np.full((1, 3), 0.5), image)
    np.testing.assert_allclose(image, 0.5)


def test_no_pixel_wanted() -> None:
    found = between(*some_points(20), np.zeros(SHAPE, np.bool_))
    assert found is not None and not found.any()
