"""The COLMAP loader: bin and txt, camera models, rescaled photos, tracks, and damaged files."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.errors import UserError
from framework.scenes.assemble import intrinsics
from framework.scenes.lens import Distortion, undistort
from framework.scenes.points import FEWEST
from framework.types import Scene
from tests.built import load_scene
from tests.data import open_scene
from tests.scenes.synthetic import FOCAL, HEIGHT, WIDTH, Point, write_model, write_scene


def load(folder: Path, **options: object) -> Scene:
    return load_scene("colmap", {"path": str(folder), "n_views": 3, **options})


def to_binary(folder: Path) -> Path:
    """Turn the scene's text model into a binary one; returns its folder."""
    import pycolmap

    sparse = folder / "sparse" / "0"
    model = pycolmap.Reconstruction(str(sparse))
    shutil.rmtree(sparse)
    sparse.mkdir()
    model.write_binary(str(sparse))
    return sparse


def test_poses_intrinsics_and_bounds(tmp_path: Path) -> None:
    scene = load(write_scene(tmp_path))
    view = scene.training.views[1]
    assert view.name == "im05.png" and view.mask is None and view.depth is None
    assert view.camera.center.tolist() == pytest.approx([0.5, 0.0, 0.0])
    assert view.camera.K.tolist() == intrinsics(FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2).tolist()
    assert (scene.training.near, scene.training.far) == pytest.approx((4.0, 6.0), rel=1e-2)
    assert scene.training.points.visible.all()


def test_text_and_binary_agree(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    text = load(folder)
    sparse = to_binary(folder)
    assert (sparse / "images.bin").is_file()
    assert load(folder).fingerprint == text.fingerprint


def test_points_of_test_tracks_never_reach_training(tmp_path: Path) -> None:
    tracks = [(0, 8), (0, 1, 8), (0, 2, 3, 4, 8), (1, 5), (0, 5, 9), (1, 5, 9)]
    points = [((0.1 * k, 0.0, 4.0 + k), track) for k, track in enumerate(tracks)]
    scene = load(write_scene(tmp_path, points=points))  # training: 1, 5, 9
    assert scene.training.points.xyz[:, 2].tolist() == [7.0, 8.0, 9.0]
    assert (scene.training.points.visible.sum(1) >= 2).all()


def test_what_test_photos_found_says_nothing_about_near_and_far(tmp_path: Path) -> None:
    """Training: 1, 5, 9. Points of one of them and a test photo may lie anywhere."""
    shared: list[Point] = [((0.01 * k, 0.0, 4.0 + 0.1 * k), (1, 5)) for k in range(FEWEST)]
    scenes = []
    for name, away in (("a", 5.0), ("b", 900.0)):
        points = [*shared, ((0.0, 0.0, away), (0, 1))]
        scenes.append(load(write_scene(tmp_path / name, points=points)).training)
    assert (scenes[0].near, scenes[0].far) == (scenes[1].near, scenes[1].far)
    assert 4.0 <= scenes[0].near < scenes[0].far <= 5.9


def test_names_with_blanks_and_a_camera_that_no_photo_has(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    folder = write_scene(tmp_path)
    for photo in (folder / "images").glob("*.png"):
        photo.rename(photo.with_name(photo.name.replace("im", "my  photo ")))
    images, cameras = (folder / f"sparse/0/{name}.txt" for name in ("images", "cameras"))
    images.write_text(images.read_text().replace(" im", " my  photo "))
    fisheye = "2 OPENCV_FISHEYE 40 30 50 50 20 15 0 0 0 0\n"
    cameras.write_text(cameras.read_text().replace("cameras: 1", "cameras: 2") + fisheye)
    scene = load(folder)
    assert [v.name for v in scene.training.views] == [f"my  photo {i:02d}.png" for i in (1, 5, 9)]


def test_radial_photos_are_straightened_at_load(tmp_path: Path) -> None:
    folder = write_scene(tmp_path)
    camera = f"SIMPLE_RADIAL {WIDTH} {HEIGHT} 50 20 15 0.3"
    write_model(folder / "sparse" / "0", 10, [((0, 0, 4), range(10))], camera)
    view = load(folder).training.views[0]
    stored = np.asarray(Image.open(folder / "images" / "im01.png"), dtype=np.float32) / 255
    expected, _ = undistort(
        (stored * 255).round().astype(np.uint8), view.camera.K.numpy(), Distortion(k1=0.3)
    )
    assert torch.equal(view.image, torch.from_numpy(expected.transpose(2, 0, 1).copy()) / 255)
    assert view.mask is not None and 0 < float(view.mask.mean()) < 1


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin", "points3D.bin"])
def test_truncated_binaries_end_in_one_line(tmp_path: Path, file: str) -> None:
    sparse = to_binary(write_scene(tmp_path))
    whole = (sparse / file).read_bytes()
    for size in sorted({0, 4, 8, 12, 40, len(whole) // 2, len(whole) - 1}):
        (sparse / file).write_bytes(whole[:size])
        with pytest.raises(UserError, match="truncated or damaged") as caught:
            load(tmp_path)
        assert "\n" not in str(caught.value) and file in str(caught.value)
    (sparse / file).write_bytes(whole + b"\0")
    with pytest.raises(UserError, match="expected its end, got 1 more bytes"):
        load(tmp_path)


def test_every_other_error(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="got no such folder"):
        load(tmp_path)
    folder = write_scene(tmp_path)
    with pytest.raises(UserError, match="n_views of at most 8"):
        load(folder, n_views=9)
    Image.new("RGB", (WIDTH - 5, HEIGHT)).save(folder / "images" / "im05.png")
    with pytest.raises(UserError, match=r"im05.png: expected the camera's 40x30 .* got 35x30"):
        load(folder)
    Image.new("RGBA", (WIDTH, HEIGHT)).save(folder / "images" / "im05.png")
    with pytest.raises(UserError, match=r"im05.png: expected .* not transparent"):
        load(folder)
    for file in (folder / "images").iterdir():
        Image.new("RGB", (WIDTH, HEIGHT), "green").save(file)
    with pytest.raises(UserError, match=r"training photos that show .* got 3 of one colour each"):
        load(folder)
    shutil.rmtree(folder / "sparse")
    with pytest.raises(UserError, match="expected a COLMAP model in sparse/0 or sparse"):
        load(folder)


@pytest.mark.parametrize(
    "name", ["lund_door", "dtu_scan65", "mip360_kitchen", "nerf_fox", "middlebury_motorcycle"]
)
def test_real_scenes(name: str) -> None:
    """The points reproject where the training views see them: poses and intrinsics are right."""
    n_views = 1 if name == "middlebury_motorcycle" else 6
    training = load(open_scene(name), n_views=n_views).training
    assert 0 < training.near < training.far
    for k, view in enumerate(training.views):
        camera, xyz = view.camera, training.points.xyz[training.points.visible[:, k]]
        pixel = (xyz @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]) @ camera.K.T
        uv = pixel[:, :2] / pixel[:, 2:]
        assert (pixel[:, 2] > 0).all()
        size = torch.tensor([camera.width, camera.height])
        assert ((uv > -2) & (uv < size + 2)).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: b"\xef\xbb\xbf" + text,
        lambda text: text.decode().encode("utf-16"),
        lambda text: text.replace(b"\n", b"\r\n"),
        lambda text: text.removesuffix(b"\n"),
    ],
    ids=["mark", "utf-16", "crlf", "no newline"],
)
def test_texts_of_other_systems(tmp_path: Path, change: Callable[[bytes], bytes]) -> None:
    folder = write_scene(tmp_path)
    sound = load(folder)
    for file in (folder / "sparse/0").iterdir():
        file.write_bytes(change(file.read_bytes()))
    assert load(folder).fingerprint == sound.fingerprint


def test_the_newer_of_text_and_binary_is_read(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write_scene(tmp_path)
    old = to_binary(folder)
    for file in old.iterdir():
        os.utime(file, (1e9, 1e9))
    points: list[Point] = [((0.3, 0.1, 5.0), range(10))]
    write_model(old, 10, points)
    assert load(folder).training.points.xyz[:, 2].tolist() == [5.0]
    assert "the .txt files are newer and are read" in caplog.text
    caplog.clear()
    for file in old.glob("*.txt"):
        os.utime(file, (1e9, 1e9))
    assert load(folder).training.points.xyz[:, 2].tolist() == [4.0, 6.0]
    assert not caplog.text
