"""Ways of a camera: which suits, that it is smooth, closed and where it should be."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from framework.exports import export
from framework.exports.flight import flight, lens_of, looking
from framework.exports.opened import open_run
from framework.exports.rig import rig
from framework.exports.upright import moved_camera, upright
from framework.types import Camera
from tests.exports.folders import all_around, camera_at, run_folder, side_by_side

ARC = [camera_at((3 * math.cos(a), -1.0, 3 * math.sin(a))) for a in np.linspace(0, 2.5, 6)]


@pytest.mark.parametrize(
    ("cameras", "kind"),
    [
        (side_by_side(), "spiral"),
        (side_by_side(1), "spiral"),
        (all_around(), "orbit"),
        (all_around(3), "orbit"),
        (ARC, "spline"),
    ],
)
def test_the_path_follows_from_how_the_cameras_stand(cameras: list, kind: str) -> None:  # type: ignore[type-arg]
    assert rig(cameras).kind == kind


def test_the_rig_knows_where_it_looks_and_which_way_is_up() -> None:
    stood = rig(all_around(8))
    assert np.allclose(stood.focus, 0, atol=1e-2)
    assert np.allclose(stood.up, [0, -1, 0], atol=1e-6)
    assert stood.largest_gap == pytest.approx(2 * math.pi / 8, abs=1e-2)


@pytest.mark.parametrize("kind", ["spline", "spiral", "orbit"])
def test_a_flight_is_smooth_and_closed(kind: str, tmp_path: Path) -> None:
    run = open_run(run_folder(tmp_path / "run", all_around()))
    lens = lens_of([inputs.camera for inputs in run.cameras], None)
    way = flight(run, kind, 60, lens)
    assert len(way) == 60
    for camera in way:
        R = camera.viewmat[:3, :3].numpy()
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0
    centers = [camera.center.numpy() for camera in way]
    steps = [np.linalg.norm(b - a) for a, b in pairwise([*centers, centers[0]])]
    assert max(steps) < 1.0 and steps[-1] <= 1.5 * max(steps[:-1])


def test_an_orbit_keeps_the_cameras_distance(tmp_path: Path) -> None:
    run = open_run(run_folder(tmp_path / "run", all_around()))
    way = flight(run, "orbit", 12, run.cameras[0].camera)
    for camera in way:
        assert float(camera.center.norm()) == pytest.approx(math.sqrt(10), rel=0.02)


def test_a_spline_passes_the_cameras_and_comes_back(tmp_path: Path) -> None:
    run = open_run(run_folder(tmp_path / "run", ARC))
    way = flight(run, "spline", 40, run.cameras[0].camera)
    assert np.allclose(way[0].viewmat, run.cameras[0].camera.viewmat, atol=1e-9)
    assert np.allclose(way[20].viewmat, run.cameras[-1].camera.viewmat, atol=1e-6)
    assert np.allclose(way[10].viewmat, way[30].viewmat, atol=1e-9)


def test_sides_are_even() -> None:
    lens = lens_of(side_by_side(), 33)
    assert (lens.width, lens.height) == (32, 24)
    assert float(lens.K[0, 0]) == pytest.approx(50 * 32 / 48)


def above_a_field(n: int = 6) -> list[Camera]:
    """A drone's way: all look straight down, every second one flies back."""
    return [camera_at((0, -4, 0), (0, 0, (-1) ** k)) for k in range(n)]


def test_cameras_without_a_common_up_have_that_of_the_first(tmp_path: Path) -> None:
    stood = rig(above_a_field())
    assert np.allclose(stood.up, [0, 0, 1], atol=1e-9)
    folder = run_folder(tmp_path / "run", above_a_field())
    assert export.main([str(folder)], "export") == 0
    motion = upright(stood, 4.0)
    assert np.allclose(motion[:3, :3] @ motion[:3, :3].T, np.eye(3), atol=1e-9)
    moved = moved_camera(above_a_field()[0], motion)
    assert np.allclose(moved.viewmat[:3, :3], np.eye(3), atol=1e-9)


def test_a_camera_that_looks_along_down_has_some_down() -> None:
    pose = looking(np.zeros(3), np.array([0, 1.0, 0]), np.array([0, 2.0, 0]))
    assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3)) and pose[2, 1] == 1
