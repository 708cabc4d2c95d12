"""Which test cameras stand between the training cameras, by hand and by another algorithm."""

import numpy as np
import pytest
from scipy.optimize import nnls

from framework.compute.rng import stream
from framework.scenes.assemble import Shot, Tracks, assemble
from framework.scenes.placement import REACH, _near_hull


def by_least_squares(points: np.ndarray) -> float:
    rows = np.vstack([points.T, np.full(len(points), 1e4)])
    weights, _ = nnls(rows, np.array([0.0, 0.0, 0.0, 1e4]))
    return float(np.linalg.norm(weights @ points) / weights.sum())


@pytest.mark.parametrize("seed", range(60))
def test_near_the_hull_is_what_a_least_squares_solver_finds(seed: int) -> None:
    draw = stream(seed, "hull")
    points = draw.standard_normal((2 + seed % 12, 3))
    points[:, 2] += seed % 3
    for scale in REACH / max(by_least_squares(points), 1e-9) * np.array([0.9, 1.1]):
        scaled = points * min(scale, 5.0)
        assert _near_hull(scaled) == (by_least_squares(scaled) <= REACH)


def test_a_scene_tags_its_test_views_alone_and_keeps_given_tags() -> None:
    """Cameras that look anywhere, so that their centre is not minus their translation."""

    def shot(name: str, center: tuple[float, float, float], tags: tuple[str, ...] = ()) -> Shot:
        rotation = np.linalg.qr(stream(len(name), name).standard_normal((3, 3)))[0]
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ center
        return Shot(name, viewmat, np.eye(3), np.zeros((4, 4, 3), np.uint8), tags=tags)

    train = [shot("a", (10.0, 0.0, 0.0)), shot("bb", (12.0, 0.0, 0.0))]
    places = [(11.0, 0.4, 0.0), (11.0, 0.6, 0.0), (13.0, 0.0, 0.0), (11.0, 0.0, 0.0)]
    test = [shot(f"t{i}", place, ("given",) if i == 3 else ()) for i, place in enumerate(places)]
    scene = assemble("s", "p", train, test, Tracks(), 1.0, 2.0)
    outside = ("extrapolating",)
    assert [v.tags for v in scene.test] == [("interpolating",), outside, outside, ("given",)]
    assert all(v.tags == () for v in scene.training.views)
