"""The Mip-NeRF 360 loader: its photos, its protocol, and that it else is the COLMAP loader."""

from pathlib import Path

from framework.types import Scene
from tests.built import load_scene
from tests.scenes.synthetic import write_scene


def load(folder: Path, **options: object) -> Scene:
    return load_scene("mip360", {"path": str(folder), "n_views": 3, **options})


def test_points_need_two_training_views(tmp_path: Path) -> None:
    tracks = [(0, 8), (0, 1, 8), (1, 5), (0, 5, 9)]  # training: 1, 5, 9
    points = [((0.1 * k, 0.0, 4.0 + k), track) for k, track in enumerate(tracks)]
    training = load(write_scene(tmp_path, points=points)).training
    assert training.points.xyz[:, 2].tolist() == [6.0, 7.0]
