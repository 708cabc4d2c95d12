"""NeRF's layout of rendered objects: the literature's views, the paper behind them, every error."""

from __future__ import annotations

import json
import logging
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.initialize import background_color
from framework.types import Scene
from tests.built import load_scene

SIDE, ANGLE = 16, 0.8
USUAL = (26, 86, 2, 55, 75, 93, 16, 73, 8)  # DietNeRF's eight; FreeNeRF and DNGaussian have a ninth


def pose(turn: float) -> list[list[float]]:
    """OpenGL camera-to-world on a circle of radius 4 about z, looking at the origin."""
    c, s = math.cos(turn), math.sin(turn)
    return [[-s, 0, c, 4 * c], [c, 0, s, 4 * s], [0, 1, 0, 0], [0, 0, 0, 1]]


def write(folder: Path, training: int = 5, testing: int = 3, opaque: bool = False) -> Path:
    """Frames in an order that is not that of their names: r_0, r_1, ... r_10."""
    for part, count in (("train", training), ("test", testing)):
        (folder / part).mkdir(parents=True)
        frames = []
        for i in range(count):
            pixels = stream(i, f"tests/blender/{part}").integers(0, 256, (SIDE, SIDE, 4), np.uint8)
            pixels[..., 3] |= 255 * opaque
            Image.fromarray(pixels).save(folder / part / f"r_{i}.png")
            turn = 2 * math.pi * i / count + 0.1 * (part == "test")
            frames.append({"file_path": f"./{part}/r_{i}", "transform_matrix": pose(turn)})
        data = {"camera_angle_x": ANGLE, "frames": frames}
        (folder / f"transforms_{part}.json").write_text(json.dumps(data))
    return folder


def load(folder: Path, **options: object) -> Scene:
    return load_scene("blender", {"path": str(folder), "downscale": 1, **options})


def numbers(scene: Scene) -> tuple[list[int], list[int]]:
    """Training and test views; their names contain their file."""
    both = []
    for part, views in (("train", scene.training.views), ("test", scene.test)):
        assert all(view.name.startswith(f"{part}/r_") for view in views)
        both.append([int(view.name[len(part) + 3 : -4]) for view in views])
    return both[0], both[1]


@pytest.fixture(scope="module")
def lego(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("lego"), 100, 200)


@pytest.mark.parametrize("views", [3, 8, 9])
def test_the_literatures_views_are_counted_as_the_files_list_them(lego: Path, views: int) -> None:
    train, test = numbers(load(lego, n_views=views))
    assert train == sorted(USUAL[:views]) and test == list(range(0, 200, 8))


def test_more_views_all_views_and_held_out_ones(lego: Path) -> None:
    every, test = numbers(load(lego, n_views="all"))
    assert every == list(range(100)) and len(test) == 25
    train, _ = numbers(load(lego, n_views=12))
    assert train == [int(i) for i in np.round(np.linspace(0, 99, 12))]
    held = load(lego, split="blender_held_out")
    judged = {int(view.name[8:-4]) for view in held.test}
    assert numbers(replace(held, test=()))[0] == sorted(USUAL[:8])
    assert all(view.name.startswith("train/") for view in held.test)
    assert len(judged) == 6 and not judged & {*USUAL[:8]}


def test_an_object_of_ones_own(tmp_path: Path) -> None:
    folder = write(tmp_path)
    with pytest.raises(UserError, match=r"split=blender, got 5 and 3; scene\.split=file takes any"):
        load(folder)
    with pytest.raises(UserError, match=r"split=blender_drawn1, got 5 and 3; scene\.split=file"):
        load(folder, split="blender_drawn1")
    assert numbers(load(folder, split="file", n_views=3)) == ([0, 2, 4], [0, 1, 2])
    assert numbers(load(folder, split="file", n_views="all"))[0] == [0, 1, 2, 3, 4]


def test_the_camera_and_the_bounds(tmp_path: Path) -> None:
    scene = load(write(tmp_path), split="file", n_views="all")
    camera = scene.training.views[0].camera
    torch.testing.assert_close(camera.center, torch.tensor([4.0, 0, 0], dtype=torch.float64))
    ahead = camera.viewmat[2, :3]
    torch.testing.assert_close(ahead, torch.tensor([-1.0, 0, 0], dtype=torch.float64))
    assert float(camera.K[0, 0]) == pytest.approx(SIDE / 2 / math.tan(ANGLE / 2))
    assert (scene.training.near, scene.training.far) == (2.0, 6.0)
    half = load(tmp_path, split="file", n_views="all", downscale=2).training.views[0]
    assert half.image.shape == (3, SIDE // 2, SIDE // 2)


@pytest.mark.parametrize(("paper", "grey"), [("white", 1.0), ("black", 0.0)])
def test_renders_stand_on_what_photos_were_laid_on(
    tmp_path: Path, paper: str, grey: float, caplog: pytest.LogCaptureFixture
) -> None:
    training = load(write(tmp_path), split="file", n_views=3, paper=paper).training
    pixels = np.asarray(Image.open(tmp_path / "train" / "r_0.png")) / 255.0
    alpha = pixels[..., 3:]
    expected = np.rint(255 * (pixels[..., :3] * alpha + grey * (1 - alpha))).transpose(2, 0, 1)
    assert np.array_equal((training.views[0].image.numpy() * 255).round(), expected)
    for kind in ("mean", "random", paper):
        with caplog.at_level(logging.WARNING):
            assert background_color(kind, training).tolist() == [grey] * 3
    assert not caplog.records
    other = "black" if paper == "white" else "white"
    assert background_color(other, training).tolist() == [1 - grey] * 3
    assert f"laid on {paper}, renders on {other}" in caplog.text


def test_opaque_photos_lie_on_no_paper(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    training = load(write(tmp_path, opaque=True), split="file", n_views=3).training
    assert training.paper is None
    mean = background_color("mean", training)
    assert float(mean.min()) > 0.3 and float(mean.max()) < 0.7
    assert background_color("black", training).tolist() == [0, 0, 0] and not caplog.records


def test_a_test_photo_may_not_train(tmp_path: Path) -> None:
    folder = write(tmp_path)
    data = json.loads((folder / "transforms_test.json").read_text())
    data["frames"][1]["file_path"] = "train/r_3.png"
    (folder / "transforms_test.json").write_text(json.dumps(data))
    message = (
        r"transforms_test\.json: expected photos that transforms_train\.json does not list, 1 are"
    )
    with pytest.raises(UserError, match=message + r" in both \(first: r_3\.png\)"):
        load(folder, split="file")


def test_what_is_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="scene=blender: expected a folder at"):
        load(tmp_path / "none")
    with pytest.raises(UserError, match=r"transforms_train\.json: expected camera poses, found no"):
        load(tmp_path)
    with pytest.raises(UserError, match=r"scene=blender: expected 0 < near < far, got near=7"):
        load(write(tmp_path), near=7.0)
    message = r"transforms\.json: .* found no file, but transforms_train\.json; take scene=blender"
    with pytest.raises(UserError, match=message):
        load_scene("transforms", {"path": str(tmp_path), "near": 1.0, "far": 9.0})


def test_all_photos_train_without_a_file_of_tests(tmp_path: Path) -> None:
    folder = write(tmp_path)
    assert len(load(folder, split="none", n_views="all").training.views) == 8
    (folder / "transforms_test.json").unlink()
    scene = load(folder, split="none", n_views="all")
    assert (len(scene.training.views), scene.test) == (5, ())


def test_an_object_outside_the_depth_bounds(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The cameras stand 4 away from what they look at."""
    folder = write(tmp_path)
    load(folder, split="file", n_views=5)
    assert not caplog.text
    load(folder, split="file", n_views=5, near=5.0, far=9.0)
    assert "look at a point at depth 4, outside scene.near=5 and scene.far=9" in caplog.text


def test_missing_photos_and_masks(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write(tmp_path, 100, 200)
    for name in ("train/r_26", "train/r_5", "test/r_0", "test/r_3"):
        (folder / f"{name}.png").unlink()
    (folder / "masks/train").mkdir(parents=True)
    mask = np.full((SIDE, SIDE), 255, np.uint8)
    mask[:4] = 0
    Image.fromarray(mask).save(folder / "masks/train/r_86.png")
    scene = load(folder, n_views=3)
    train, test = numbers(scene)
    assert train == [2, 55, 86] and test == list(range(8, 200, 8))
    assert "4 of 300 photos are missing and left out (r_5, r_26, r_0, r_3)" in caplog.text
    assert scene.training.views[2].mask is not None
    assert not scene.training.views[2].mask[:4].any() and scene.training.views[0].mask is None
