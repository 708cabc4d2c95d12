"""Which views are matched, and between which depths."""

from dataclasses import replace
from pathlib import Path

import pytest

from framework.depth.matching.neighbours import FARTHER, NEARER, choose_neighbours, depth_bounds
from framework.types import TrainingSet
from tests.built import load_scene
from tests.depth.plane import FAR, NEAR, camera, no_points, plane_scene, view
from tests.scenes.synthetic import write_llff, write_scene


def row_of_views() -> TrainingSet:
    views = tuple(
        view(str(x), camera((x, 0.0, 0.0), (48, 36), 45.0)) for x in (0.0, 0.02, 0.8, 30.0)
    )
    return TrainingSet("row", views, no_points(4), NEAR, FAR)


def test_neighbours_have_parallax_and_overlap() -> None:
    assert choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))[0] == 2
    assert 3 not in choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))
    assert len(choose_neighbours(row_of_views(), 0, 1, (NEAR, FAR))) == 1


def test_bounds_of_the_user_bound_the_search() -> None:
    found = plane_scene(n_points=200)
    low, high = depth_bounds(found, 1)
    assert NEAR < low < high < FAR
    for given, expected in (
        ((True, False), (NEAR, high)),
        ((False, True), (low, FAR)),
        ((True, True), (NEAR, FAR)),
    ):
        assert depth_bounds(replace(found, given=given), 1) == expected
        bare = depth_bounds(replace(found, given=given, points=no_points(3)), 1)
        widened = (NEARER * NEAR, FARTHER * FAR)
        scene = zip(given, (NEAR, FAR), widened, strict=True)
        assert bare == tuple(bound if kept else wide for kept, bound, wide in scene)


def test_a_bound_beyond_the_points_of_a_view() -> None:
    training = replace(plane_scene(n_points=200), near=7.0, far=9.0, given=(True, False))
    assert depth_bounds(training, 1) == (7.0, FARTHER * 9.0)


@pytest.mark.parametrize(
    ("options", "given"),
    [({}, (False, False)), ({"near": 3.0}, (True, False)), ({"far": 9.0}, (False, True))],
)
def test_a_training_set_knows_which_bounds_the_user_gave(
    tmp_path: Path, options: dict[str, float], given: tuple[bool, bool]
) -> None:
    for loader, write in (("colmap", write_scene), ("llff", write_llff)):
        folder = str(write(tmp_path / loader))
        scene = load_scene(loader, {"path": folder, "n_views": 3, **options})
        assert scene.training.given == given
