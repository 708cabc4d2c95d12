"""NeRF's layout of rendered objects: the literature's views, the paper behind them, every error."""

import json
import logging
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.initialize.background import background_color
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


def test_a_photo_that_is_transparent_everywhere_is_refused(tmp_path: Path) -> None:
    Image.new("RGBA", (SIDE, SIDE)).save(write(tmp_path) / "train" / "r_0.png")
    with pytest.raises(UserError, match=r"r_0.png: expected .* some that are not transparent"):
        load(tmp_path, split="file", n_views=3)


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
