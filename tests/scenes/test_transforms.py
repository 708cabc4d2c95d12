"""The transforms.json loader: conventions by hand, agreement with COLMAP, and every error."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.scenes.lens import Distortion, undistort
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


def test_paths_without_suffix_and_angles(tmp_path: Path) -> None:
    def blender(data: Data) -> None:
        del data["fl_x"]
        data["camera_angle_x"] = 2 * math.atan(WIDTH / 2 / FOCAL)
        data["frames"] = frames(name="./images/im{:02d}")

    first = load(write(tmp_path), **BOUNDS)
    second = load(write(tmp_path, blender), **BOUNDS)
    assert [v.name for v in second.test] == [v.name for v in first.test]
    a, b = first.training.views[0].camera, second.training.views[0].camera
    assert torch.allclose(a.K, b.K) and torch.equal(a.viewmat, b.viewmat)
    Image.new("RGB", (WIDTH, HEIGHT)).save(tmp_path / "images" / "im01.jpg")
    with pytest.raises(UserError, match=r"expected one photo .* im01.jpg, im01.png"):
        load(tmp_path, **BOUNDS)


def test_a_frame_has_its_own_intrinsics_and_stated_size(tmp_path: Path) -> None:
    def own(data: Data) -> None:
        data["frames"][1] |= {
            "fl_x": 120.0,
            "fl_y": 130.0,
            "cx": 41.0,
            "cy": 29.0,
            "w": 80,
            "h": 60,
        }

    camera = load(write(tmp_path, own), **BOUNDS).training.views[0].camera
    assert camera.K.tolist() == [[60, 0, 20.5], [0, 65, 14.5], [0, 0, 1]]
    small = load(tmp_path, downscale=2, **BOUNDS).training.views[0].camera
    assert (small.width, small.height) == (20, 15)
    assert small.K.tolist() == [[30, 0, 10.25], [0, 32.5, 7.25], [0, 0, 1]]


def test_photos_are_undistorted(tmp_path: Path) -> None:
    lens = {"k1": 0.2, "k2": 0.03, "p1": 0.01, "p2": -0.02, "camera_model": "OPENCV"}
    view = load(write(tmp_path, lambda d: d.update(lens)), **BOUNDS).training.views[0]
    stored = np.asarray(Image.open(tmp_path / "images" / "im01.png"))
    straight, mask = undistort(stored, view.camera.K.numpy(), Distortion(0.2, 0.03, 0.01, -0.02))
    assert np.array_equal((view.image.numpy() * 255).round().transpose(1, 2, 0), straight)
    assert view.mask is not None and mask is not None and np.array_equal(view.mask, mask)


@pytest.mark.parametrize(("paper", "grey"), [("white", 255), ("black", 0)])
def test_transparency_is_laid_on_paper(tmp_path: Path, paper: str, grey: int) -> None:
    write(tmp_path)
    pixels = stream(0, "tests/rgba").integers(0, 256, (HEIGHT, WIDTH, 4), dtype=np.uint8)
    Image.fromarray(pixels, "RGBA").save(tmp_path / "images" / "im01.png")
    image = load(tmp_path, paper=paper, **BOUNDS).training.views[0].image
    alpha = pixels[..., 3:] / 255.0
    expected = np.rint(pixels[..., :3] * alpha + grey * (1 - alpha)).transpose(2, 0, 1)
    assert np.array_equal((image.numpy() * 255).round(), expected)


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


def test_bad_plys(tmp_path: Path) -> None:
    write(tmp_path)
    with pytest.raises(UserError, match=r"fused.ply: expected a PLY file of coloured points"):
        load(tmp_path, points="fused.ply")
    (tmp_path / "fused.ply").write_bytes(b"ply\nno\n")
    with pytest.raises(UserError, match="expected a PLY header, got none"):
        load(tmp_path, points="fused.ply")
    write_ply(tmp_path / "fused.ply", [(0, 0, 4)], "f4")
    with pytest.raises(UserError, match="expected colours of type uchar, got float32"):
        load(tmp_path, points="fused.ply")


def test_bounds_without_points_must_be_given(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"give scene.near and scene.far"):
        load(write(tmp_path), near=1.0)
    with pytest.raises(UserError, match=r"expected 0 < near < far, got near=3.0, far=2.0"):
        load(tmp_path, near=3.0, far=2.0)


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


def test_no_file_and_no_json(tmp_path: Path) -> None:
    write_images(tmp_path / "images", 10)
    with pytest.raises(UserError, match="expected camera poses, found no file"):
        load(tmp_path)
    for text, message in (
        ("{", "expected JSON, got something else"),
        ("[]", "expected a JSON object"),
    ):
        (tmp_path / "transforms.json").write_text(text)
        with pytest.raises(UserError, match=message) as caught:
            load(tmp_path)
        assert "\n" not in str(caught.value)


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


def test_masks_of_frames(tmp_path: Path) -> None:
    """Black does not count, of a photo with a lens no pixel that is made of some of it."""

    def masked(data: Data) -> None:
        for i, frame in enumerate(data["frames"]):
            frame["mask_path"] = f"masks/{i}.png"

    with pytest.raises(UserError, match=r"masks/1\.png: expected a mask, found no file"):
        load(write(tmp_path, masked), **BOUNDS)
    (tmp_path / "masks").mkdir()
    pixels = np.full((HEIGHT, WIDTH), 255, np.uint8)
    pixels[:, :10] = 0
    for i in range(10):
        Image.fromarray(pixels).save(tmp_path / f"masks/{i}.png")
    mask = load(tmp_path, **BOUNDS).training.views[0].mask
    assert mask is not None and mask[:, :10].sum() == 0 and bool(mask[:, 10:].all())
    bent = load(write(tmp_path, lambda data: (masked(data), data.update(k1=0.2))), **BOUNDS)
    mask = bent.training.views[0].mask
    assert mask is not None and mask[:, :10].sum() == 0 and bool(mask[5:-5, 22:-5].all())
    Image.fromarray(0 * pixels).save(tmp_path / "masks/1.png")
    with pytest.raises(UserError, match="expected some white pixels in a mask"):
        load(tmp_path, **BOUNDS)
    with pytest.raises(UserError, match="expected mask_path to be a file's name, got 3"):
        load(write(tmp_path, lambda data: data["frames"][0].update(mask_path=3)), **BOUNDS)


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


def test_how_photos_may_be_named(tmp_path: Path) -> None:
    """An absolute path in the folder, or without a suffix in capitals."""
    folder = write(tmp_path)
    (folder / "images/im00.png").rename(folder / "images/im00.PNG")

    def renamed(data: Data) -> None:
        data["frames"][0]["file_path"] = "images/im00"
        data["frames"][1]["file_path"] = str((folder / "images/im01.png").resolve())

    scene = load(write(folder, renamed), **BOUNDS)
    assert [v.name for v in scene.training.views] == [f"images/im{i:02d}.png" for i in (1, 5, 9)]
    assert scene.test[0].name == "images/im00.PNG"
    with pytest.raises(UserError, match="expected names inside this folder"):
        load(write(folder, lambda data: data["frames"][1].update(file_path="/x/a.png")), **BOUNDS)


def test_a_file_from_windows(tmp_path: Path) -> None:
    folder = write(tmp_path)
    sound = load(folder, **BOUNDS)

    def from_windows(data: Data) -> None:
        for i, frame in enumerate(data["frames"]):
            frame["file_path"] = f".\\images\\im{i:02d}.PNG" if i % 2 else f"D:\\w\\im{i:02d}.png"
        data["test_filenames"] = [data["frames"][0]["file_path"]]

    path = write(folder, from_windows) / "transforms.json"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b", ", b",\r\n"))
    assert load(folder, **BOUNDS).fingerprint == sound.fingerprint
    assert [v.name for v in load(folder, split="file", **BOUNDS).test] == ["images/im00.png"]


def test_k4_is_read_where_its_meaning_is_clear(tmp_path: Path) -> None:
    """nerfstudio's k4 is a polynomial's next term, OpenCV's divides."""
    lens = {"camera_model": "FULL_OPENCV", "k1": 0.1, "k4": 0.3}
    view = load(write(tmp_path, lambda d: d.update(lens)), **BOUNDS).training.views[0]
    assert view.lens == (0.1, 0, 0, 0, 0, 0.3, 0, 0)
    with pytest.raises(UserError, match=r"got k4; .* or set camera_model to FULL_OPENCV"):
        load(write(tmp_path, lambda d: d.update(lens, camera_model="OPENCV")), **BOUNDS)


def test_a_frames_own_angle_comes_before_a_common_focal_length(tmp_path: Path) -> None:
    def wide(data: Data) -> None:
        data["fl_y"] = FOCAL
        for frame in data["frames"]:
            frame["camera_angle_x"] = 2.0

    K = load(write(tmp_path, wide), **BOUNDS).training.views[0].camera.K
    assert K[0, 0].item() == pytest.approx(WIDTH / 2 / math.tan(1.0))
    assert K[1, 1].item() == pytest.approx(K[0, 0].item())


def test_one_photo_cannot_both_train_and_test(tmp_path: Path) -> None:
    folder = write(tmp_path, lambda data: data.update(frames=frames(1)))
    with pytest.raises(UserError, match="expected a photo to train on, got none of 1"):
        load(folder, **{**BOUNDS, "n_views": "all"})
