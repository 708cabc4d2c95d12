"""Removing lens distortion and shrinking photos, against OpenCV and by hand."""

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
from framework.scenes.lens import Distortion, distorted_pixels

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
