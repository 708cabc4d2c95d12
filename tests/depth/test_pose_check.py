"""Poses that do not fit the photos are found before any training, and the repair is named."""

import logging
from dataclasses import replace

import numpy as np
import pytest
import torch

from framework import registry
from framework.depth.pose_check import LIMIT, check_poses
from framework.errors import UserError
from framework.run import poses
from framework.scenes.assemble import Tracks
from framework.scenes.conventions import CONVENTIONS, decoded_as, repaired
from framework.scenes.points import depth_bounds
from framework.types import Camera, TrainingSet


@pytest.fixture(scope="module")
def room() -> TrainingSet:
    options = {"name": "embedded", "n_views": 4, "width": 128, "height": 96}
    training: TrainingSet = registry.part("scene", options).load().training
    return training


class _Loader:
    poses = "opengl_c2w"


def _renamed(training: TrainingSet) -> TrainingSet:
    images = [view.image for view in training.views]
    views = [
        replace(v, image=i) for v, i in zip(training.views, images[2:] + images[:2], strict=True)
    ]
    return replace(training, views=tuple(views))


def test_sound_poses_pass(room: TrainingSet) -> None:
    check = check_poses(room)
    assert check is not None and check.fits and check.ratio > 1.3


@pytest.mark.parametrize("other", ["opencv_w2c", "llff_c2w"])
def test_convention_that_fits_is_named(
    room: TrainingSet, other: str, caplog: pytest.LogCaptureFixture
) -> None:
    # a file that writes `other` and is read as OpenGL
    wrong = repaired(room, other, "opengl_c2w")
    with caplog.at_level(logging.WARNING):
        check = poses.checked_poses("transforms", _Loader(), wrong)
    assert check is not None and not check.fits
    assert f"scene.poses={other}" in caplog.text


def test_upside_down_photos_and_depth_bounds_are_named(
    room: TrainingSet, caplog: pytest.LogCaptureFixture
) -> None:
    turned = poses._turned(room)
    near = poses._between(room, room.near / 4, room.near)
    with caplog.at_level(logging.WARNING):
        for wrong in (turned, near):
            check = poses.checked_poses("colmap", object(), wrong)
            assert check is not None and not check.fits
    assert "EXIF" in caplog.text and "scene.far" in caplog.text


def test_photos_in_another_order_fail(room: TrainingSet) -> None:
    check = check_poses(_renamed(room))
    assert check is not None and check.ratio < LIMIT
    assert "order" in check.warning()


def test_photos_of_different_sizes_are_not_exchanged(room: TrainingSet) -> None:
    first, second = room.views[:2]
    camera = Camera(second.camera.viewmat, second.camera.K, 150, 120)
    other = replace(second, camera=camera, image=second.image[:, :, :150].contiguous())
    points = replace(room.points, visible=room.points.visible[:, :2])
    assert check_poses(replace(room, views=(first, other), points=points)) is None


def test_exact_poses_are_not_checked(room: TrainingSet) -> None:
    assert (
        poses.checked_poses("embedded", registry.part("scene", {"name": "embedded"}), room) is None
    )


@pytest.mark.parametrize("ours", CONVENTIONS)
@pytest.mark.parametrize("other", CONVENTIONS)
def test_conventions_invert(room: TrainingSet, ours: str, other: str) -> None:
    viewmat = room.views[1].camera.viewmat.numpy()
    there = decoded_as(viewmat, ours, other)
    assert np.allclose(decoded_as(there, other, ours), viewmat, atol=1e-12)
    assert np.allclose(there[:3, :3] @ there[:3, :3].T, np.eye(3), atol=1e-12)
    assert torch.linalg.det(torch.from_numpy(there)).item() == pytest.approx(1)


def test_points_behind_the_cameras_name_the_option(caplog: pytest.LogCaptureFixture) -> None:
    xyz, seen = np.ones((20, 3)), np.ones((20, 2), dtype=bool)
    xyz[:, 2] = -5.0
    tracks = Tracks(xyz, np.zeros((20, 3), np.uint8), seen)
    with pytest.raises(UserError, match=r"100% of the points lie behind .* set scene\.poses"):
        depth_bounds(tracks, [np.eye(4)] * 2, [0, 1], "scene=colmap: x")
    xyz[5:, 2] = 4.0
    with caplog.at_level(logging.WARNING):
        assert depth_bounds(tracks, [np.eye(4)] * 2, [0, 1], "x")[0] == pytest.approx(4.0)
    assert "25% of the points" in caplog.text and "scene.poses" in caplog.text
