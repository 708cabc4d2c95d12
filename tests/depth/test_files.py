"""Depth from files and from the scene: round trips, alignment, and one clear line per error."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

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


def _renamed(scene: TrainingSet, *names: str) -> TrainingSet:
    views = [replace(v, name=name) for v, name in zip(scene.views, names, strict=True)]
    return replace(scene, views=tuple(views))


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


def _provoke(case: str, folder: Path, scene: TrainingSet) -> dict[str, object]:
    """Write what is wrong in `case`; returns the provider's options."""
    write(folder, scene, exact(scene), ".npy")
    first = folder / "left.npy"
    if case == "folder":
        return {"path": str(folder / "nowhere")}
    if case == "missing":
        first.unlink()
    elif case == "truncated":
        first.write_bytes(first.read_bytes()[:200])
    elif case == "pickled":
        np.save(first, np.array([{"a": 1}]), allow_pickle=True)
    elif case == "aspect":
        np.save(first, np.ones((72, 72)))
    return {"path": str(folder), "align": "scale" if case == "points" else "none"}


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ("folder", "expected a folder at .*nowhere"),
        ("missing", "for view 'left.JPG', got none"),
        ("truncated", r"expected 55,424 bytes for shape .* got 200"),
        ("pickled", "expected numbers, got type object"),
        ("aspect", "aspect ratio of the 96x72 image .* got 72x72"),
        ("points", "needs 8 sparse points .* got 0; use depth.align=none"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, case: str, message: str) -> None:
    scene = plane_scene()
    options = _provoke(case, tmp_path, scene)
    with pytest.raises(UserError, match=message) as caught:
        build_provider("file", options).estimate(scene)
    assert "\n" not in str(caught.value)
