"""Several models, masks, missing photos, and poses without points: what every loader does."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.scenes.listed import match_photos
from framework.scenes.points import FEWEST
from framework.types import Scene
from tests.built import load_scene
from tests.scenes.synthetic import FOCAL, HEIGHT, WIDTH, Point, llff_rows, write_model, write_scene
from tests.scenes.test_transforms import frames, write_ply

LOADERS = ("colmap", "mip360", "transforms", "llff")


def write(folder: Path, points: list[Point] | None = None) -> Path:
    """A folder of ten photos that each of LOADERS reads."""
    write_scene(folder, points=points)
    np.save(folder / "poses_bounds.npy", llff_rows())
    data = {"fl_x": FOCAL, "frames": frames()}
    (folder / "transforms.json").write_text(json.dumps(data))
    return folder


def load(loader: str, folder: Path, **options: object) -> Scene:
    return load_scene(loader, {"path": str(folder), "n_views": 3, **options})


def names(scene: Scene) -> list[str]:
    return [view.name.removeprefix("images/") for view in (*scene.training.views, *scene.test)]


def spread(train: tuple[int, ...], n: int = 2 * FEWEST) -> list[Point]:
    """Points at depths 4 to 6 that the images in `train` see."""
    x, y = (stream(0, "tests/spread").uniform(-0.5, 1.0, (2, n)) * [[1], [0.5]]).tolist()
    return [((x[k], y[k], 4.0 + 2 * k / n), train) for k in range(n)]


@pytest.mark.parametrize("loader", LOADERS)
def test_the_model_of_most_photos(
    tmp_path: Path, loader: str, caplog: pytest.LogCaptureFixture
) -> None:
    first = load(loader, write(tmp_path, spread(tuple(range(10)))))
    assert not caplog.text
    shutil.move(tmp_path / "sparse/0", tmp_path / "sparse/1")
    write_model(tmp_path / "sparse/0", 3, [((0, 0, 4.0), (0, 1, 2))])
    write_model(tmp_path / "colmap/sparse/0", 6, [((0, 0, 4.0), (0, 1, 2))])
    (tmp_path / "colmap/sparse/0/cameras.txt").write_text("no")
    assert load(loader, tmp_path).fingerprint == first.fingerprint
    assert "sparse/1 is used, with poses of 10 photos, and not sparse/0 (3 photos)" in caplog.text
    assert "colmap/sparse/0 (" in caplog.text and "scene.model=FOLDER" in caplog.text
    assert load(loader, tmp_path, model="sparse/1").fingerprint == first.fingerprint
    with pytest.raises(UserError, match="expected names inside this folder"):
        load(loader, tmp_path, model="../x")


def test_a_chosen_model_and_photos_without_a_pose(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write(tmp_path)
    write_model(tmp_path / "sparse/1", 4, spread((1, 2, 3)))
    scene = load("colmap", tmp_path, model="sparse/1")
    assert names(scene) == [f"im0{i}.png" for i in (1, 2, 3, 0)]
    assert "6 of 10 photos have no pose in the COLMAP model" in caplog.text
    assert "(im04.png, im05.png, im06.png, im07.png, im08.png and 1 more)" in caplog.text


@pytest.mark.parametrize("loader", LOADERS)
def test_missing_photos_are_left_out(
    tmp_path: Path, loader: str, caplog: pytest.LogCaptureFixture
) -> None:
    write(tmp_path, spread(tuple(range(10))))
    for i in (2, 3, 4, 5):
        (tmp_path / f"images/im0{i}.png").unlink()
    (tmp_path / "images/im06.png").rename(tmp_path / "images/IM06.JPG")
    scene = load(loader, tmp_path)
    assert "4 of 10 photos are missing and left out (im02.png, im03.png, im04.png" in caplog.text
    assert "IM06.JPG for im06.png" in caplog.text
    assert len(match_photos(tmp_path, ["..png", ".png"])) == 0
    trained = [0.1, 0.7, 0.9]  # x of cameras 1, 7 and 9
    assert [v.camera.center[0].item() for v in scene.training.views] == pytest.approx(trained)
    assert len(scene.training.points.xyz) == 2 * FEWEST
    with pytest.raises(UserError, match="n_views of at most 5"):
        load(loader, tmp_path, n_views=6)
    shutil.rmtree(tmp_path / "images")
    (tmp_path / "images").mkdir()
    with pytest.raises(UserError, match=r"all are missing|no image in it"):
        load(loader, tmp_path)


@pytest.mark.parametrize("loader", LOADERS)
@pytest.mark.parametrize("name", ["im{:02d}.png.png", "im{:02d}.png", "IM{:02d}.PNG"])
def test_masks(tmp_path: Path, loader: str, name: str, caplog: pytest.LogCaptureFixture) -> None:
    write(tmp_path)
    mask = np.full((2 * HEIGHT, 2 * WIDTH), 255, np.uint8)
    mask[:, :20] = 0
    (tmp_path / "masks").mkdir()
    for i in range(10):
        Image.fromarray(mask).save(tmp_path / "masks" / name.format(i))
    scene = load(loader, tmp_path)
    assert not caplog.text
    for view in (*scene.training.views, *scene.test):
        assert view.mask is not None and not view.mask[:, :10].any() and view.mask[:, 10:].all()
    (tmp_path / "masks" / name.format(3)).unlink()
    load(loader, tmp_path)
    assert "1 of 10 photos have no mask and count as a whole" in caplog.text


def textured(folder: Path) -> Path:
    """Ten photos of a plane at depth 5, taken 0.2 apart, with known poses and no points."""
    rng = stream(0, "tests/textured")
    small = rng.integers(0, 256, (60, 160, 3), dtype=np.uint8)
    plane = np.asarray(Image.fromarray(small).resize((320, 120), Image.Resampling.BICUBIC))
    (folder / "images").mkdir(parents=True)
    for i in range(10):
        Image.fromarray(plane[:, 8 * i :][:, :160]).save(folder / f"images/im{i:02d}.png")
    camera = "PINHOLE 160 120 200 200 80 60"
    write_model(folder / "sparse/0", 10, [], camera, center_step=0.2)
    return folder


@pytest.mark.parametrize(("loader", "points"), [("colmap", ""), ("mip360", None)])
def test_known_poses_without_points(
    tmp_path: Path, loader: str, points: str | None, caplog: pytest.LogCaptureFixture
) -> None:
    folder = textured(tmp_path)
    file = folder / "sparse/0/points3D.txt"
    file.unlink() if points is None else file.write_text(points)
    training = load(loader, folder).training
    assert (training.near, training.far) == pytest.approx((5.0, 5.0), rel=0.05)
    assert "triangulated from matches of the training photos" in caplog.text
    assert len(training.points.xyz) > FEWEST
    assert training.points.xyz[:, 2].numpy() == pytest.approx(5.0, rel=0.1)
    again = load(loader, folder)
    for i in (0, 8):  # test photos have no say
        Image.new("RGB", (160, 120)).save(folder / f"images/im{i:02d}.png")
    assert np.array_equal(load(loader, folder).training.points.xyz, again.training.points.xyz)
    inputs = load(loader, folder, near=1.0, far=9.0).training
    assert (inputs.near, inputs.far, len(inputs.points.xyz)) == (1.0, 9.0, 0)


def flat_photos(folder: Path) -> None:
    """Photos of one colour but for a corner, which says nothing about the colours of points."""
    photo = Image.new("RGB", (WIDTH, HEIGHT), (9, 9, 9))
    photo.putpixel((0, 0), (0, 0, 0))
    for file in (folder / "images").iterdir():
        photo.save(file)


def test_points_of_one_photo_stay_with_it(tmp_path: Path) -> None:
    """Networks write one track per point: points of a test photo's depth stay out."""
    flat_photos(write(tmp_path, [*spread((1,), 30), *spread((8,), 30)]))
    training = load("colmap", tmp_path).training
    assert 25 < len(training.points.xyz) <= 30


def test_points_as_a_ply_in_the_model(tmp_path: Path) -> None:
    write(tmp_path)
    (tmp_path / "sparse/0/points3D.txt").unlink()
    write_ply(tmp_path / "sparse/0/points3D.ply", [xyz for xyz, _ in spread((1,))])
    training = load("colmap", tmp_path).training
    assert len(training.points.xyz) > FEWEST and 3.9 < training.near < training.far < 6.1


WORLD = [[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 3]]


@pytest.mark.parametrize("source", ["model", "ply"])
def test_a_folder_of_nerfstudio(tmp_path: Path, source: str) -> None:
    """ns-process-data turns the world of its COLMAP model, which it keeps in colmap/sparse/0."""
    model = load("colmap", write(tmp_path, spread(tuple(range(10))))).training
    (tmp_path / "colmap").mkdir()
    shutil.move(tmp_path / "sparse", tmp_path / "colmap/sparse")
    world = np.vstack([WORLD, [0, 0, 0, 1]])
    listed = frames()
    for frame in listed:
        frame["transform_matrix"] = (world @ np.array(frame["transform_matrix"])).tolist()
    points = model.points.xyz.numpy() @ world[:3, :3].T + world[:3, 3]
    write_ply(tmp_path / "sparse_pc.ply", [tuple(xyz) for xyz in points.tolist()])
    data = {"applied_transform": WORLD, "ply_file_path": "sparse_pc.ply"}
    data |= {"fl_x": FOCAL, "frames": listed}
    (tmp_path / "transforms.json").write_text(json.dumps(data))
    assert load("colmap", tmp_path).training.near == model.near
    if source == "ply":
        shutil.rmtree(tmp_path / "colmap")
    training = load("transforms", tmp_path).training
    assert (training.near, training.far) == pytest.approx((model.near, model.far), rel=1e-3)
    assert len(training.points.xyz) == len(points)
    assert np.allclose(np.sort(training.points.xyz, axis=0), np.sort(points, axis=0), atol=1e-5)
