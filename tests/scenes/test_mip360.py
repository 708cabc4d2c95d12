"""The Mip-NeRF 360 loader: its photos, its protocol, and that it else is the COLMAP loader."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.scenes.colmap_model import read_model
from framework.types import Scene
from tests.built import load_scene
from tests.data import open_scene
from tests.scenes.synthetic import HEIGHT, WIDTH, write_images, write_scene


def load(folder: Path, **options: object) -> Scene:
    return load_scene("mip360", {"path": str(folder), "n_views": 3, **options})


def test_an_eighth_is_the_usual_size(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    assert load(folder).training.views[0].camera.width == WIDTH
    write_images(folder / "images_8", 10, WIDTH // 8, round(HEIGHT / 8))
    assert load(folder).training.views[0].camera.width == WIDTH // 8
    assert load(folder, images="images").training.views[0].camera.width == WIDTH
    assert load(folder, images="images", downscale=2).training.views[0].camera.width == WIDTH // 2
    with pytest.raises(UserError, match=r"images_2: expected a folder of .* no such folder"):
        load(folder, images="images_2")


def test_points_need_two_training_views(tmp_path: Path) -> None:
    tracks = [(0, 8), (0, 1, 8), (1, 5), (0, 5, 9)]  # training: 1, 5, 9
    points = [((0.1 * k, 0.0, 4.0 + k), track) for k, track in enumerate(tracks)]
    training = load(write_scene(tmp_path, points=points)).training
    assert training.points.xyz[:, 2].tolist() == [6.0, 7.0]


def test_errors_name_the_loader(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"scene=mip360: .* n_views of at most 8"):
        load(write_scene(tmp_path), n_views=24)
    with pytest.raises(UserError, match="scene=mip360: expected a folder at"):
        load(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    layout = "scene=mip360: expected images_8/ or images/ with the photos, and sparse/0/, in "
    with pytest.raises(UserError, match=layout):
        load(tmp_path / "empty")


def test_kitchen_views_are_all_around() -> None:
    """Twelve cameras around what they look at; bounds and extent fit the rig."""
    folder = open_scene("mip360_kitchen")
    scene = load_scene("mip360", {"path": str(folder)})
    training = scene.training
    assert scene.protocol == "mip360" and len(training.views) == 12
    assert [v.name for v in scene.test] == ["00.png", "08.png", "16.png", "24.png"]
    centers = torch.stack([v.camera.center for v in training.views])
    axes = torch.stack([v.camera.viewmat[2, :3] for v in training.views])
    middle = torch.linalg.lstsq(
        torch.cat([torch.eye(3) - a[:, None] * a for a in axes.float()]),
        torch.cat([c - a * (a @ c) for a, c in zip(axes.float(), centers.float(), strict=True)]),
    ).solution
    depth = ((middle - centers) * axes).sum(1)
    assert ((depth > training.near) & (depth < training.far)).all()
    toward = (centers - middle) / (centers - middle).norm(dim=1, keepdim=True)
    assert float((toward @ toward.T).min()) < -0.5  # some are on opposite sides
    assert 0.5 < training.extent / float(depth.mean()) < 3
    tracks = read_model(folder / "sparse" / "0").tracks
    allowed = tracks.xyz[tracks.seen[:, [int(v.name[:2]) for v in training.views]].sum(1) >= 2]
    assert np.array_equal(training.points.xyz.numpy(), allowed)
