"""Which views are matched, and between which depths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from framework.depth.matching.bounds import FARTHER, NEARER, depth_bounds
from framework.depth.matching.neighbours import angle_weight, choose_neighbours
from framework.types import TrainingSet
from tests.depth.plane import FAR, NEAR, camera, no_points, plane_scene, view


def row_of_views() -> TrainingSet:
    views = tuple(
        view(str(x), camera((x, 0.0, 0.0), (48, 36), 45.0)) for x in (0.0, 0.02, 0.8, 30.0)
    )
    return TrainingSet("row", views, no_points(4), NEAR, FAR)


def test_neighbours_have_parallax_and_overlap() -> None:
    assert choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))[0] == 2
    assert 3 not in choose_neighbours(row_of_views(), 0, 4, (NEAR, FAR))
    assert len(choose_neighbours(row_of_views(), 0, 1, (NEAR, FAR))) == 1


def test_shared_points_decide_where_there_are_enough() -> None:
    scene = plane_scene(60)
    scene.points.visible[1:, 1] = False
    assert choose_neighbours(scene, 0, 4, (NEAR, FAR)) == [2]


def test_a_second_partner_may_be_weak_a_third_one_may_not() -> None:
    scene = plane_scene(60)
    scene.points.visible[5:, 1] = False
    assert choose_neighbours(scene, 0, 4, (NEAR, FAR)) == [2, 1]
    more = replace(scene, views=(*scene.views, scene.views[2]))
    visible = torch.cat([scene.points.visible, scene.points.visible[:, 2:]], 1)
    more = replace(more, points=replace(scene.points, visible=visible))
    assert choose_neighbours(more, 0, 4, (NEAR, FAR)) == [2, 3]


def test_angle_weight_prefers_ten_degrees() -> None:
    cameras = [camera((x, 0.0, 0.0), (48, 36), 45.0) for x in (0.0, 0.05, 0.9, 9.0)]
    point = np.array([[0.0, 0.0, 5.0]])
    small, good, wide = (float(angle_weight(point, cameras[0], c)[0]) for c in cameras[1:])
    assert good == 1.0
    assert small < 0.3
    assert wide < 0.1


def test_bounds_come_from_points_or_from_the_scene() -> None:
    assert depth_bounds(plane_scene(), 0) == (NEARER * NEAR, FARTHER * FAR)
    near, far = depth_bounds(plane_scene(200), 0)
    assert 4 < near / NEARER < 5 < far / FARTHER < 6
