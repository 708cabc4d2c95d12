"""Depth from files and from the scene: round trips, alignment, and one clear line per error."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from framework.depth.read import _as_cut, find_file, resample
from framework.errors import UserError
from framework.types import TrainingSet
from tests.built import build_provider
from tests.depth.plane import plane_depth, plane_scene


def exact(training: TrainingSet) -> list[np.ndarray]:
    return [plane_depth(v.camera) for v in training.views]


def write(folder: Path, training: TrainingSet, maps: list[np.ndarray], suffix: str) -> None:
    for view, values in zip(training.views, maps, strict=True):
        file = folder / f"{Path(view.name).stem}{suffix}"
        if suffix == ".npy":
            np.save(file, values)
        elif suffix == ".npz":
            np.savez(file, depth=values)
        else:
            cv2.imwrite(str(file), np.rint(values * 5000).astype(np.uint16))


@pytest.mark.parametrize("suffix", [".npy", ".npz", ".png"])
def test_files_are_read_back(tmp_path: Path, suffix: str) -> None:
    scene = plane_scene()
    write(tmp_path, scene, exact(scene), suffix)
    options = {"path": str(tmp_path), "align": "none", "png_scale": 5000.0}
    for actual, truth in zip(
        build_provider("file", options).estimate(scene), exact(scene), strict=True
    ):
        np.testing.assert_allclose(actual.depth.numpy(), truth, atol=2e-4)
        assert float(actual.confidence.min()) == 1


@pytest.mark.parametrize(
    ("kind", "mode"),
    [("depth", "scale"), ("inverse_depth", "scale"), ("inverse_depth", "scale_shift")],
)
def test_alignment_recovers_scene_units(tmp_path: Path, kind: str, mode: str) -> None:
    scene = plane_scene(100)
    outliers = scene.points.xyz.clone()
    outliers[::5] *= 1.3  # a fifth of the points is wrong
    scene = replace(scene, points=replace(scene.points, xyz=outliers))
    shift = 0.7 if mode == "scale_shift" else 0.0
    maps = [(d if kind == "depth" else 1 / d) * 40 + shift for d in exact(scene)]
    write(tmp_path, scene, maps, ".npy")
    options = {"path": str(tmp_path), "kind": kind, "align": mode}
    for actual, truth in zip(
        build_provider("file", options).estimate(scene), exact(scene), strict=True
    ):
        np.testing.assert_allclose(actual.depth.numpy(), truth, rtol=0.01)


def test_maps_of_another_size_are_resampled(tmp_path: Path) -> None:
    scene = plane_scene()
    write(tmp_path, scene, [np.repeat(np.repeat(d, 2, 0), 2, 1) for d in exact(scene)], ".npy")
    options = {"path": str(tmp_path), "align": "none"}
    actual = build_provider("file", options).estimate(scene)[0]
    np.testing.assert_allclose(actual.depth.numpy(), exact(scene)[0], rtol=1e-6)


def test_maps_of_stored_photos_lose_the_lens_too(tmp_path: Path) -> None:
    scene, lens = plane_scene(), (-0.2, 0.0, 0.0, 0.0, 0.0)
    bent = replace(scene, views=tuple(replace(view, lens=lens) for view in scene.views))
    maps = []
    for view in scene.views:
        height, width = view.image.shape[1:]
        rows, columns = np.mgrid[:height, :width]
        maps.append(1.0 + columns + 1000.0 * rows)  # a value encodes its position
    write(tmp_path, scene, maps, ".npy")
    options = {"path": str(tmp_path), "align": "none"}
    view, actual = bent.views[0], build_provider("file", options).estimate(bent)[0].depth.numpy()
    K, (height, width) = view.camera.K.numpy(), view.image.shape[1:]
    row, column = height // 8, width // 8
    x, y = (column + 0.5 - K[0, 2]) / K[0, 0], (row + 0.5 - K[1, 2]) / K[1, 1]
    factor = 1 - 0.2 * (x * x + y * y)
    u, v = K[0, 0] * x * factor + K[0, 2], K[1, 1] * y * factor + K[1, 2]
    assert (int(u), int(v)) != (column, row)
    assert actual[row, column] == maps[0][int(v), int(u)]
    assert actual[height // 2, width // 2] == maps[0][height // 2, width // 2]
    straight = build_provider("file", {**options, "straight": True}).estimate(bent)[0]
    assert straight.depth[row, column] == maps[0][row, column]


def test_resampling_keeps_edges_and_holes_sharp() -> None:
    values = np.array([[1.0, 1.02, 5.0, 0.0]])
    larger = resample(values, 16, 4)
    assert larger.shape == (4, 16)
    assert not ((larger > 1.03) & (larger < 5)).any()
    assert not ((larger > 0) & (larger < 1)).any()
    assert (larger[:, 1:6] > 1).any()


def test_invalid_values_are_counted_or_masked(tmp_path: Path) -> None:
    scene = plane_scene()
    maps = exact(scene)
    maps[1][0, :3] = [np.nan, np.inf, -1]
    write(tmp_path, scene, maps, ".npy")
    options = {"path": str(tmp_path), "align": "none"}
    with pytest.raises(UserError, match=r"middle\.npy, got 3 of 8320 invalid \(1 NaN, 1 inf"):
        build_provider("file", options).estimate(scene)
    actual = build_provider("file", {**options, "invalid": "mask"}).estimate(scene)[1]
    assert actual.depth[0, :3].tolist() == actual.confidence[0, :3].tolist() == [0, 0, 0]
    assert float(actual.confidence[1:].min()) == 1


def _renamed(scene: TrainingSet, *names: str) -> TrainingSet:
    views = [replace(v, name=name) for v, name in zip(scene.views, names, strict=True)]
    return replace(scene, views=tuple(views))


def test_views_of_the_same_name_have_their_own_files(tmp_path: Path) -> None:
    scene = _renamed(plane_scene(), "cam1/0001.jpg", "cam2/0001.jpg", "cam2/0002.jpg")
    for i, file in enumerate(("cam1/0001.npy", "cam2/0001.jpg.npy", "0002.npy")):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        np.save(tmp_path / file, np.full_like(exact(scene)[i], i + 1))
    actual = build_provider("file", {"path": str(tmp_path), "align": "none"}).estimate(scene)
    assert [float(m.depth.max()) for m in actual] == [1, 2, 3]


@pytest.mark.parametrize("names", [("cam1/0001.jpg", "cam2/0001.jpg"), ("0001.jpg", "0001.png")])
def test_a_file_for_two_views_is_refused(tmp_path: Path, names: tuple[str, str]) -> None:
    scene = _renamed(plane_scene(), *names, "other.jpg")
    for stem in ("0001", "other"):
        np.save(tmp_path / f"{stem}.npy", exact(scene)[0])
    provider = build_provider("file", {"path": str(tmp_path), "align": "none"})
    expected = rf"0001\.npy for both '{names[0]}' and '{names[1]}'; arrange the files"
    for use in (provider.estimate, provider.fingerprint):
        with pytest.raises(UserError, match=expected):
            use(scene)


@pytest.mark.parametrize("name", ["../left.png", "/left.png"])
def test_a_name_outside_the_folder_counts_by_its_last_part(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "depth"
    folder.mkdir()
    np.save(tmp_path / "left.npy", np.ones(1))  # not ours
    np.save(folder / "left.npy", np.ones(1))
    assert find_file(folder, name) == folder / "left.npy"


def test_the_fingerprint_follows_the_files(tmp_path: Path) -> None:
    scene = plane_scene()
    write(tmp_path, scene, exact(scene), ".npy")
    provider = build_provider("file", {"path": str(tmp_path)})
    first = provider.fingerprint(scene)
    assert provider.fingerprint(scene) == first
    np.save(tmp_path / "unrelated.npy", np.ones(1))
    assert provider.fingerprint(scene) == first
    np.save(tmp_path / "middle.npy", 1.01 * exact(scene)[1])
    assert provider.fingerprint(scene) != first
    for name in ("ground_truth", "plane_sweep"):
        assert build_provider(name, {}).fingerprint(scene) == ""


def test_tolerance_drops_what_no_other_view_confirms(tmp_path: Path) -> None:
    scene = plane_scene()
    maps = exact(scene)
    maps[0][30:40, 40:50] *= 1.2
    write(tmp_path, scene, maps, ".npy")
    options = {"path": str(tmp_path), "align": "none", "tolerance": 0.03}
    confidence = build_provider("file", options).estimate(scene)[0].confidence
    assert float(confidence[30:40, 40:50].max()) == 0
    assert float(confidence.mean()) > 0.7


def _provoke(case: str, folder: Path, scene: TrainingSet) -> dict[str, object]:
    """Write what is wrong in `case`; returns the provider's options."""
    write(folder, scene, exact(scene), ".npy")
    first = folder / "left.npy"
    if case == "folder":
        return {"path": str(folder / "nowhere")}
    if case == "missing":
        first.unlink()
    elif case == "twice":
        np.savez(folder / "left.npz", depth=np.ones((72, 96)))
    elif case == "truncated":
        first.write_bytes(first.read_bytes()[:200])
    elif case == "pickled":
        np.save(first, np.array([{"a": 1}]), allow_pickle=True)
    elif case == "key":
        first.unlink()
        np.savez(folder / "left.npz", disparity=np.ones((72, 96)))
    elif case == "shape":
        np.save(first, np.ones((3, 72, 96)))
    elif case == "aspect":
        np.save(first, np.ones((72, 72)))
    elif case == "png":
        first.unlink()
        cv2.imwrite(str(folder / "left.png"), np.ones((72, 96), np.uint8))
    return {"path": str(folder), "align": "scale" if case == "points" else "none"}


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("folder", "expected a folder at .*nowhere"),
        ("missing", "for view 'left.JPG', got none"),
        ("twice", r"got left\.npy, left\.npz; remove"),
        ("truncated", r"expected 55,424 bytes for shape .* got 200"),
        ("pickled", "expected numbers, got type object"),
        ("key", "expected .depth., got .disparity."),
        ("shape", r"got shape \(3, 72, 96\)"),
        ("aspect", "aspect ratio of the 96x72 image .* got 72x72"),
        ("png", "16-bit grey png .* got uint8"),
        ("points", "needs 8 sparse points .* got 0; use depth.align=none"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, case: str, message: str) -> None:
    scene = plane_scene()
    options = _provoke(case, tmp_path, scene)
    with pytest.raises(UserError, match=message) as caught:
        build_provider("file", options).estimate(scene)
    assert "\n" not in str(caught.value)


def test_a_wrong_kind_is_noticed(tmp_path: Path) -> None:
    scene = plane_scene(100)
    write(tmp_path, scene, [1 / d for d in exact(scene)], ".npy")
    options = {"path": str(tmp_path), "kind": "depth", "align": "scale_shift"}
    with pytest.raises(UserError, match=r"depth\.kind=inverse_depth"):
        build_provider("file", options).estimate(scene)


def test_ground_truth_is_the_views_own_depth() -> None:
    scene = plane_scene()
    actual = build_provider("ground_truth", {}).estimate(scene)
    assert all(torch.equal(m.depth, v.depth) for m, v in zip(actual, scene.views, strict=True))
    bare = replace(scene, views=(replace(scene.views[0], depth=None), *scene.views[1:]))
    with pytest.raises(UserError, match=r"got none for view 'left.JPG'; use depth=plane_sweep"):
        build_provider("ground_truth", {}).estimate(bare)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("plane_swep", {}, "did you mean 'plane_sweep'"),
        ("file", {}, "depth.path: expected the folder of the depth maps, got nothing"),
        ("file", {"path": "x", "kind": "disparity"}, "kind: expected one of depth, inverse_depth"),
        ("file", {"path": "x", "align": "affine"}, "align: expected one of scale"),
        ("file", {"path": "x", "png_scale": 0}, "png_scale: expected a number > 0, got 0"),
        ("ground_truth", {"planes": 3}, "unknown option 'planes'"),
    ],
)
def test_bad_names_and_options(name: str, options: dict[str, object], message: str) -> None:
    with pytest.raises(UserError, match=message):
        build_provider(name, options)


def test_a_map_is_cut_as_reducing_its_photo_did() -> None:
    """An eighth of 1007x500 is 125x62: seven columns and four rows are left out."""
    columns = np.tile(np.arange(1007.0), (500, 1))
    assert _as_cut(columns, 125, 62).shape == (496, 1000)
    for height, width in (
        (62, 125),
        (31, 63),
        (500, 1010),
        (252, 504),
        (63, 126),
    ):  # of its size, smaller, of another cut
        assert _as_cut(np.zeros((height, width)), 125, 62).shape == (height, width)
