"""Cameras that no scene can have end in one line, whichever loader reads them; and small deviations
are none."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from framework.errors import UserError
from tests.built import load_scene
from tests.scenes.synthetic import write_scene


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
    assert "image im01.png: expected a rotation, a quaternion of length 1" in message


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
