"""The transforms.json loader: conventions by hand, agreement with COLMAP, and every error."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.types import Scene
from tests.built import load_scene
from tests.data import open_scene
from tests.scenes.synthetic import FOCAL, HEIGHT, WIDTH, write_images, write_model, write_table

Data = dict[str, Any]
BOUNDS = {"near": 1.0, "far": 10.0}


def pose(i: int) -> list[list[float]]:
    """OpenGL camera-to-world of a camera at x = 0.1 i that looks along +z, y down."""
    return [[1.0, 0, 0, 0.1 * i], [0, -1.0, 0, 0], [0, 0, -1.0, 0], [0, 0, 0, 1.0]]


def frames(n: int = 10, name: str = "images/im{:02d}.png") -> list[Data]:
    return [{"file_path": name.format(i), "transform_matrix": pose(i)} for i in range(n)]


def write(folder: Path, change: Callable[[Data], object] = lambda data: None) -> Path:
    if not (folder / "images").exists():
        write_images(folder / "images", 10)
    data: Data = {"fl_x": FOCAL, "frames": frames()}
    change(data)
    (folder / "transforms.json").write_text(json.dumps(data))
    return folder


def load(folder: Path, **options: object) -> Scene:
    return load_scene("transforms", {"path": str(folder), "n_views": 3, **options})


def test_axes_intrinsics_and_split(tmp_path: Path) -> None:
    scene = load(write(tmp_path), **BOUNDS)
    view = scene.training.views[0]
    assert [v.name for v in scene.training.views] == [f"images/im{i:02d}.png" for i in (1, 5, 9)]
    assert [v.name for v in scene.test] == ["images/im00.png", "images/im08.png"]
    expected = torch.eye(4, dtype=torch.float64)
    expected[0, 3] = -0.1
    assert torch.equal(view.camera.viewmat, expected)
    assert view.camera.K.tolist() == [[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]]
    assert view.mask is None
    assert (scene.training.near, scene.training.far) == (1.0, 10.0)


def test_points_need_two_training_views(tmp_path: Path) -> None:
    write(tmp_path)
    tracks = [(0, 8), (0, 2, 8), (1, 0), (1, 5), (0, 5, 9)]  # training: 1, 5, 9
    points = [((0.1 * k, 0.0, 4.0 + k), track) for k, track in enumerate(tracks)]
    write_model(tmp_path / "sparse" / "0", 10, points)
    training = load(tmp_path).training
    assert training.points.visible.tolist() == [[True, True, False], [False, True, True]]
    assert (training.near, training.far) == pytest.approx((6.0, 8.0), rel=1e-2)
    none = load(tmp_path, points="none", **BOUNDS).training
    assert len(none.points.xyz) == 0
    write_model(tmp_path / "sparse" / "0", 10, points, center_step=0.2)
    with pytest.raises(UserError, match=r"expected the poses of transforms.json"):
        load(tmp_path)


def write_ply(path: Path, xyz: list[tuple[float, float, float]], colour: str = "u1") -> None:
    names = [(a, "f4") for a in "xyz"] + [(c, colour) for c in ("red", "green", "blue")]
    table = np.array([(*p, 10, 20, 30) for p in xyz], dtype=names)
    write_table(path, table)


def test_a_named_ply_gives_points_inside_two_training_images(tmp_path: Path) -> None:
    write(tmp_path)
    write_ply(
        tmp_path / "fused.ply",
        [(0.5, 0.0, 4.0), (0.5, 0.0, -4.0), (-1.4, 0.0, 4.0), (float("nan"), 0.0, 4.0)],
    )
    assert len(load(tmp_path, **BOUNDS).training.points.xyz) == 0  # never taken by itself
    training = load(tmp_path, points="fused.ply").training
    assert training.points.xyz.tolist() == [[0.5, 0.0, 4.0]]
    assert training.points.visible.all() and training.near == pytest.approx(4.0)
    assert (training.points.rgb * 255).round().tolist() == [[10, 20, 30]]


def _frame(**changes: object) -> Callable[[Data], None]:
    return lambda data: data["frames"][3].update(changes)


def _matrix(row: int, column: int, value: float) -> Callable[[Data], None]:
    def change(data: Data) -> None:
        data["frames"][3]["transform_matrix"][row][column] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.pop("frames"), "expected a list 'frames' of photos, got none"),
        (lambda d: d["frames"][3].pop("file_path"), "frame 3: expected .* 'file_path', got none"),
        (lambda d: d["frames"][3].pop("transform_matrix"), r"im03.png\): .* 4x4 numbers, got none"),
        (_frame(transform_matrix=[[1, 2], [3, 4]]), r"4x4 numbers, got shape \(2, 2\)"),
        (_frame(transform_matrix=[[1], [3, "a"]]), r"4x4 numbers, got shape"),
        (_matrix(0, 3, float("nan")), "NaN is no number of JSON"),
        (_matrix(0, 0, 2.0), r"orthonormal camera axes .* got others \(off by 3"),
        (_matrix(0, 0, -1.0), "right-handed, orthonormal camera axes .* got left-handed ones"),
        (lambda d: d.pop("fl_x"), "expected fl_x or camera_angle_x, got neither"),
        (lambda d: d.update(fl_x=-1.0), "expected positive focal lengths, 0.4 to 40000 pixels"),
        (lambda d: d.update(fl_x="wide"), "expected fl_x to be a number, got wide"),
        (lambda d: (d.pop("fl_x"), d.update(camera_angle_x=4.0)), "camera_angle_x in .0, pi."),
        (lambda d: d.update(camera_model="OPENCV_FISHEYE"), "got OPENCV_FISHEYE; undistort"),
        (lambda d: d.update(is_fisheye=True), "got a fisheye; undistort"),
        (lambda d: d.update(k4=0.1), "got k4; undistort"),
        (lambda d: d.update(w=50, h=30), r"im0\d.png: expected the camera's 50x30 .* got 40x30"),
        (_frame(file_path="images/im02.png"), "each photo once, got images/im02.png more than"),
    ],
)
def test_bad_files(tmp_path: Path, change: Callable[[Data], object], message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        load(write(tmp_path, change), **BOUNDS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("factors", "fits"),
    [
        ((1.15, 0.9), True),
        ((1.3, 1.3), True),
        ((2.9, 1.0), True),
        ((2.0, 2.0), False),
        ((8.0, 8.0), False),
        ((0.5, 0.5), False),
        ((3.1, 1.0), False),
        ((-1.1, 1.0), False),
    ],
)
def test_a_principal_point_of_photos_of_another_size(
    tmp_path: Path, factors: tuple[float, float], fits: bool
) -> None:
    point = {"cx": factors[0] * WIDTH / 2, "cy": factors[1] * HEIGHT / 2}
    write(tmp_path, lambda data: data.update(point))
    if fits:
        assert float(load(tmp_path, **BOUNDS).training.views[0].camera.K[0, 2]) == point["cx"]
    else:
        with pytest.raises(UserError, match=r"got cx=.* for 40x30 pixels; add w and h"):
            load(tmp_path, **BOUNDS)
    write(tmp_path, lambda data: data.update(point, w=WIDTH, h=HEIGHT))  # as of a crop
    assert load(tmp_path, **BOUNDS).training.views[0].camera.K[0, 2] == point["cx"]


def test_fox_agrees_with_its_colmap_model() -> None:
    folder = open_scene("nerf_fox")
    scene = load_scene("transforms", {"path": str(folder)})
    twin = load_scene("colmap", {"path": str(folder)})
    for a, b in zip(
        (*scene.training.views, *scene.test), (*twin.training.views, *twin.test), strict=True
    ):
        assert a.name == f"images/{b.name}"
        assert torch.allclose(a.camera.viewmat, b.camera.viewmat, atol=1e-6)
        assert torch.allclose(a.camera.K, b.camera.K, atol=1e-3)
        assert torch.equal(a.image, b.image)
    assert torch.equal(scene.training.points.xyz, twin.training.points.xyz)
    assert (scene.training.points.visible.sum(1) >= 2).all()


def test_test_photos_that_the_file_names(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    names = [frame["file_path"] for frame in frames()]
    tested = [names[1], f"./{names[4]}", names[5].removesuffix(".png")]
    folder = write(tmp_path, lambda data: data.update(test_filenames=tested))
    load(folder, **BOUNDS)
    assert "names test photos, and scene.split=llff trains on 2 of them" in caplog.text
    caplog.clear()
    scene = load(folder, split="file", **BOUNDS)
    assert [v.name for v in scene.test] == [names[i] for i in (1, 4, 5)]
    assert [v.name for v in scene.training.views] == [names[i] for i in (0, 6, 9)]
    assert scene.protocol == "file" and not caplog.text
    held = load(folder, split="file_held_out", **BOUNDS)
    assert {v.name for v in held.test}.isdisjoint(
        v.name for v in [*scene.test, *scene.training.views]
    )
    write(folder, lambda data: data.update(val_filenames=names[:2], train_filenames=names[4:]))
    scene = load(folder, split="file", n_views="all", **BOUNDS)
    assert [v.name for v in scene.test] == names[:2]
    assert [v.name for v in scene.training.views] == names[4:]
    with pytest.raises(UserError, match=r"test_filenames or val_filenames for scene\.split"):
        load(write(folder), split="file", **BOUNDS)
    with pytest.raises(UserError, match=r"among its frames, 1 are not \(first: images/im99\.png"):
        load(
            write(folder, lambda data: data.update(test_filenames=["images/im99.png"])),
            split="file",
            **BOUNDS,
        )
    with pytest.raises(UserError, match="expected test_filenames to be a list of names"):
        load(write(folder, lambda data: data.update(test_filenames="all")), **BOUNDS)
