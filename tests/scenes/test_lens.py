"""Removing lens distortion and shrinking photos, against OpenCV and by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.scenes import photo
from framework.scenes.assemble import Shot, intrinsics
from framework.scenes.lens import Distortion, distorted_pixels, undistort

LENS = Distortion(0.0578421, -0.0805099, -0.000980296, 0.00015575, 0.01)


def noise(height: int, width: int) -> np.ndarray:
    return stream(0, "tests/lens").integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize("lens", [LENS, replace(LENS, k4=0.11, k5=-0.03, k6=0.02)])
def test_the_map_is_opencvs(lens: Distortion) -> None:
    K = intrinsics(348.0, 347.0, 138.6, 241.3)
    u, v, single = distorted_pixels(480, 270, K, lens)
    theirs = K.copy()
    theirs[:2, 2] -= 0.5  # their pixel centres are whole numbers
    a, b = cv2.initUndistortRectifyMap(
        theirs, np.array(lens.terms), np.eye(3), theirs, (270, 480), cv2.CV_32FC1
    )
    assert np.abs(u - 0.5 - a).max() < 1e-3 and np.abs(v - 0.5 - b).max() < 1e-3
    assert single.all()


@pytest.mark.parametrize("k", [-0.2, 0.15])
def test_undistortion_straightens_a_smooth_picture(k: float) -> None:
    """A smooth function of the undistorted direction, photographed through the lens, comes back."""
    width, height, f = 120, 90, 100.0
    K = intrinsics(f, f, 58.0, 46.0)
    x = (np.arange(width) + 0.5 - K[0, 2]) / f
    y = ((np.arange(height) + 0.5 - K[1, 2]) / f)[:, None]

    def picture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.repeat((127 + 80 * np.sin(5 * x) * np.cos(4 * y))[..., None], 3, axis=2)

    a, b = np.broadcast_arrays(x, y)
    for _ in range(30):  # fixed point of the distortion: the direction behind each stored pixel
        factor = 1 + k * (a * a + b * b)
        a, b = x / factor, y / factor
    stored = np.round(picture(a, b)).astype(np.uint8)
    out, mask = undistort(stored, K, Distortion(k1=k))
    valid = np.ones((height, width), bool) if mask is None else mask > 0
    assert (mask is None) == (k < 0)
    assert np.abs(out - picture(*np.broadcast_arrays(x, y)))[valid].max() < 2.5
    assert valid.mean() > 0.85


def test_undistortion_keeps_detail() -> None:
    """Between pixels, a bilinear filter would keep half of a photo's noise."""
    image = (noise(300, 400).astype(np.int64) // 4 + 96).astype(np.uint8)  # overshoots fit
    out, _ = undistort(image, intrinsics(400.0, 400.0, 200.0, 150.0), Distortion(k1=-0.05))
    assert out[20:-20, 20:-20].var() > 0.8 * image.var()


def test_overshoot_is_cut_off() -> None:
    """Lanczos' filter overshoots at edges of black and white; nothing wraps round."""
    board = np.indices((200, 300)).sum(0) // 4 % 2 * 255
    image = np.repeat(board[..., None], 3, axis=2).astype(np.uint8)
    out, _ = undistort(image, intrinsics(300.0, 300.0, 150.0, 100.0), Distortion(k1=-0.05))
    assert abs(out.mean() - image.mean()) < 2
    inside = out[10:-10, 10:-10]
    assert np.mean((inside < 40) | (inside > 215)) > 0.6  # squares stay black and white


def test_where_the_radial_model_folds_back_nothing_is_valid() -> None:
    K = intrinsics(40.0, 40.0, 50.0, 50.0)
    _, mask = undistort(noise(100, 100), K, Distortion(k1=-0.3))
    assert mask is not None
    r2 = ((np.arange(100) + 0.5 - 50) / 40) ** 2
    assert np.array_equal(mask[50] > 0, 1 - 0.9 * (r2 + r2[50]) > 0)


def test_where_the_rational_model_folds_back_nothing_is_valid() -> None:
    """The slope of r q(r) is that of its values."""
    K, lens = intrinsics(40.0, 40.0, 0.5, 0.5), Distortion(k4=0.9)
    u, _, single = distorted_pixels(1, 100, K, lens)
    slope = np.gradient(u[0])
    clear = np.abs(slope) > 0.01
    assert slope.min() < 0 and np.array_equal(single[0, clear], slope[clear] > 0)


def test_downscaling_averages_boxes_and_moves_the_camera_along() -> None:
    image, K = noise(7, 9), intrinsics(10.0, 12.0, 4.5, 3.5)
    mask = np.ones((7, 9), np.float32)
    mask[:2, 0], mask[4, 4:6] = 0, 0
    shot = photo.downscaled(Shot("a", np.eye(4), K, image, mask=mask), 2)
    assert shot.image.shape == (3, 4, 3)
    assert np.array_equal(shot.image[1, 2], np.rint(image[2:4, 4:6].mean((0, 1))))
    assert shot.K.tolist() == intrinsics(5.0, 6.0, 2.25, 1.75).tolist()
    assert shot.mask is not None and shot.mask.min() == 1  # half of a box is enough here
    strict = photo.downscaled(Shot("a", np.eye(4), K, image, mask=mask), 2, share=1.0)
    assert strict.mask is not None and np.argwhere(strict.mask == 0).tolist() == [[0, 0], [2, 2]]
    with pytest.raises(UserError, match="expected an image of at least 8x8 pixels, got 9x7"):
        photo.downscaled(Shot("a", np.eye(4), K, image), 8)


def test_memory_is_checked_from_the_headers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / f"{i}.png" for i in range(4)]
    for file in files:
        Image.new("RGB", (100, 50)).save(file)
    monkeypatch.setattr(photo, "SCENE_BYTES", 4 * 100 * 50 * 12)
    photo.check_memory(files, 1)
    with pytest.raises(UserError, match=r"5 views\); raise scene.downscale \(now 1\)"):
        photo.check_memory([*files, files[0]], 1)
    photo.check_memory([*files, files[0]], 2)
