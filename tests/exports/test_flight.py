"""Ways of a camera: which suits, that it is smooth, closed and where it should be."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from framework.exports.flight import flight, lens_of, rig
from framework.exports.opened import open_run
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
