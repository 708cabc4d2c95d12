"""Cameras that no scene can have end in one line, whichever loader reads them; and small deviations
are none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from framework.errors import UserError
from framework.scenes.cameras import check_places, checked_lens, checked_pose
from framework.scenes.lens import Distortion, Lens
from tests.built import load_scene
from tests.scenes.synthetic import write_llff, write_scene
from tests.scenes.test_dtu import write_dtu
from tests.scenes.test_transforms import BOUNDS
from tests.scenes.test_transforms import write as write_transforms


def _refusal(loader: str, folder: Path, **options: Any) -> str:
    with pytest.raises(UserError) as caught:
        load_scene(loader, {"path": str(folder), "n_views": 3, **options})
    return str(caught.value)


def _images(folder: Path, change: Callable[[list[str]], None]) -> Path:
    """A text model of which the words of the second image are changed."""
    file = write_scene(folder) / "sparse" / "0" / "images.txt"
    lines = file.read_text().split("\n")
    at = [i for i, line in enumerate(lines) if line.endswith(".png")][1]
    words = lines[at].split(" ")
    change(words)
    lines[at] = " ".join(words)
    file.write_text("\n".join(lines))
    return folder


def _scaled(factor: float) -> Callable[[list[str]], None]:
    def change(words: list[str]) -> None:
        words[1:5] = [repr(factor * float(word)) for word in words[1:5]]

    return change


@pytest.mark.parametrize("factor", [0.0, 5.0, 0.9, float("nan")])
def test_a_quaternion_is_a_rotation(tmp_path: Path, factor: float) -> None:
    message = _refusal("colmap", _images(tmp_path, _scaled(factor)))
    assert "images.txt: image 'im01.png': expected a rotation, a quaternion of length 1" in message


@pytest.mark.parametrize("factor", [0.995, 1.005, -1.0])
def test_a_quaternion_of_few_digits_is_normalised(tmp_path: Path, factor: float) -> None:
    options = {"path": str(_images(tmp_path, _scaled(factor))), "n_views": 3}
    scene = load_scene("colmap", options)
    for view in scene.training.views:
        rotation = view.camera.viewmat[:3, :3].numpy()
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("focal", ["0", "-45", "1e300", "1e-9"])
def test_focal_lengths_of_colmap(tmp_path: Path, focal: str) -> None:
    file = write_scene(tmp_path) / "sparse" / "0" / "cameras.txt"
    *rows, camera = file.read_text().strip().split("\n")
    words = camera.split()
    assert words[1] == "PINHOLE"
    words[5] = focal  # fy
    file.write_text("\n".join([*rows, " ".join(words)]) + "\n")
    message = _refusal("colmap", tmp_path)
    assert "camera 1: expected" in message and ("focal" in message or "finite" in message)


@pytest.mark.parametrize(
    ("place", "message"), [("1e300", "within 1e+09"), ("1e7", "expected all cameras within")]
)
def test_an_absurd_place_in_colmap(tmp_path: Path, place: str, message: str) -> None:
    """The second one is a test view's: it would enter the mean of every method."""
    folder = _images(tmp_path, lambda words: words.__setitem__(5, place))
    assert message in _refusal("colmap", folder, n_views=8)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f["transform_matrix"][0].__setitem__(3, 1e300), "within 1e+09 of the origin"),
        (lambda f: f["transform_matrix"][0].__setitem__(3, 1e8), "expected all cameras within"),
        (lambda f: f["transform_matrix"][0].__setitem__(0, 1e300), "orthonormal camera axes"),
        (lambda f: f.update(fl_x=40, fl_y=0), "expected positive focal lengths"),
        (lambda f: f.update(fl_x=40, fl_y=-40), "expected positive focal lengths"),
        (lambda f: f.update(fl_x=1e300), "expected positive focal lengths"),
        (lambda f: f.update(cx=1e300), "expected a principal point near the image"),
        (lambda f: f.update(k1=1e300), "distortion coefficients of at most 100"),
    ],
)
def test_cameras_of_transforms(tmp_path: Path, change: Callable[[Any], None], message: str) -> None:
    folder = write_transforms(tmp_path, lambda data: change(data["frames"][0]))
    assert message in _refusal("transforms", folder, **BOUNDS)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (3, 1e300, "row 0: expected a camera within"),
        (3, 1e8, "expected all cameras within"),
        (14, 1e300, "row 0: expected positive focal lengths"),
        (16, 1e300, "expected depth bounds"),
    ],
)
def test_cameras_of_llff(tmp_path: Path, column: int, value: float, message: str) -> None:
    file = write_llff(tmp_path) / "poses_bounds.npy"
    rows = np.load(file)
    rows[0 if column != 16 else slice(None), column] = value
    np.save(file, rows)
    assert message in _refusal("llff", tmp_path)


@pytest.mark.parametrize("value", [1e300, 1e14])
def test_cameras_of_dtu(tmp_path: Path, value: float) -> None:
    file = write_dtu(tmp_path) / "cameras.npz"
    with np.load(file) as stored:
        matrices = dict(stored)
    matrices["world_mat_7"][0, 3] = value
    np.savez(file, **matrices)
    assert "world_mat_7: expected" in _refusal("dtu", tmp_path)


def test_frames_are_told_by_file_too(tmp_path: Path) -> None:
    """`a.png` and `./a.png` are one."""

    def again(data: dict[str, Any]) -> None:
        data["frames"][1]["file_path"] = "./" + data["frames"][0]["file_path"].removeprefix("./")
        data["frames"][0]["file_path"] = data["frames"][0]["file_path"].removeprefix("./")

    assert "expected each photo once" in _refusal(
        "transforms", write_transforms(tmp_path, again), **BOUNDS
    )


def test_sensible_cameras_pass() -> None:
    lens = Lens(4000, 3000, 56_000.0, 56_000.0, 2000.0, -500.0, Distortion(k1=-0.4))
    assert checked_lens(lens, "a long lens, cropped") is lens
    pose = np.eye(4)
    pose[:3, :3] += 1e-4
    assert checked_pose(pose, "rounded") is pose
    rig = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [900, 0, 0]])
    check_places(rig, list("abcd"), 10.0, "a drone comes from afar")
    with pytest.raises(UserError, match="got 'd' at"):
        check_places(rig * [1e4, 1, 1], list("abcd"), 10.0, "a scene")
    check_places(np.zeros((3, 3)), list("abc"), 1.0, "one place")
