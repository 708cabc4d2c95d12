"""Which views are matched, and between which depths."""

from framework.depth.matching.neighbours import choose_neighbours
from framework.types import TrainingSet
from tests.depth.plane import FAR, NEAR, camera, no_points, view


def row_of_views() -> TrainingSet:
    views = tuple(
        view(str(x), camera((x, 0.0, 0.0), (48, 36), 45.0)) for x in (0.0, 0.02, 0.8, 30.0)
    )
    return TrainingSet("row", views, no_points(4), NEAR, FAR)


def test_neighbours_have_parallax_and_overlap() -> None:
    assert choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))[0] == 2
    assert 3 not in choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))
    assert len(choose_neighbours(row_of_views(), 0, 1, (NEAR, FAR))) == 1
