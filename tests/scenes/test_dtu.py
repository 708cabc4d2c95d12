"""The DTU loader: calibration, masks of tests and training, and every error."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.compute.rng import stream
from framework.errors import UserError
from framework.scenes.dtu_cameras import decompose
from framework.scenes.photo import DARK_RUN, background
from framework.types import Scene
from tests.built import load_scene
from tests.data import open_scene

WIDTH, HEIGHT = 40, 30
K_RIG = np.array([[2000.0, 0, 820], [0, 1900, 610], [0, 0, 1]])


def projection(i: int) -> np.ndarray:
    """The matrix of a camera at x = 10 i mm that looks along z."""
    pose = np.eye(4)[:3]
    pose[0, 3] = -10.0 * i
    return np.vstack([-3.0 * K_RIG @ pose, [0, 0, 0, 1]])  # of any scale and sign


def write_dtu(folder: Path, n: int = 49) -> Path:
    for name in ("image", "mask"):
        (folder / name).mkdir(parents=True)
    for i in range(n):
        pixels = stream(i, "tests/dtu").integers(60, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        pixels[:5] = 3
        Image.fromarray(pixels).save(folder / "image" / f"{i:06d}.png")
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[10:20, 10:30] = 255
        Image.fromarray(mask).save(folder / "mask" / f"{i:03d}.png")
    np.savez(folder / "cameras.npz", **{f"world_mat_{i}": projection(i) for i in range(n)})
    return folder


def load(folder: Path, **options: object) -> Scene:
    return load_scene("dtu", {"path": str(folder), "downscale": 1, **options})


def test_cameras_split_and_bounds(tmp_path: Path) -> None:
    scene = load(write_dtu(tmp_path / "scan9"))
    assert [v.name for v in scene.training.views] == ["000022.png", "000025.png", "000028.png"]
    assert (scene.name, scene.protocol, len(scene.test)) == ("scan9", "dtu", 25)
    camera = scene.training.views[0].camera
    expected = np.diag([1 / 40, 1 / 40, 1]) @ K_RIG
    assert torch.allclose(camera.K, torch.from_numpy(expected))
    assert camera.center.tolist() == pytest.approx([220.0, 0.0, 0.0], abs=1e-9)
    assert (scene.training.near, scene.training.far) == (425.0, 935.0)
    assert len(scene.training.points.xyz) == 0


@pytest.mark.parametrize("seed", range(5))
def test_decomposition_gives_back_the_camera(seed: int) -> None:
    rng = stream(seed, "tests/projection")
    rotation, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    rotation *= np.linalg.det(rotation)
    pose = np.column_stack([rotation, 500 * rng.standard_normal(3)])
    actual = decompose(float(rng.uniform(-5, 5)) * K_RIG @ pose, "here")
    assert np.allclose(actual.viewmat[:3], pose, atol=1e-9)
    lens = actual.lens
    assert [lens.fx, lens.fy, lens.cx, lens.cy] == pytest.approx([2000, 1900, 820, 610])


def test_tests_are_masked_by_the_object(tmp_path: Path) -> None:
    scene = load(write_dtu(tmp_path / "scan9"))
    for view in scene.test:
        assert view.mask is not None and view.mask.sum() == 200
        assert view.mask[10:20, 10:30].all()


@pytest.mark.parametrize(
    ("choice", "share"), [("full", None), ("object", 1 / 6), ("background", 5 / 6)]
)
def test_train_masks(tmp_path: Path, choice: str, share: float | None) -> None:
    training = load(write_dtu(tmp_path / "scan9"), train_mask=choice).training
    for view in training.views:
        actual = None if view.mask is None else float(view.mask.mean())
        assert actual == (None if share is None else pytest.approx(share))


def test_background_is_the_published_rule() -> None:
    """CoR-GS keeps a dark pixel as background unless one of the 49 above it, shifted in, is not."""
    image = stream(0, "tests/background").integers(0, 32, (120, 30, 3), dtype=np.uint8)
    image[:, 10:] //= 2
    dark = image.max(axis=2) < 30
    expected = dark.copy()
    for shift in range(1, DARK_RUN):
        expected[shift:] &= dark[:-shift]
    assert 0.1 < expected.mean() < 0.9
    assert np.array_equal(background(image, 30) > 0, expected)


def _npz(change: Callable[[dict[str, np.ndarray]], object]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        matrices = {f"world_mat_{i}": projection(i) for i in range(49)}
        change(matrices)
        np.savez(folder / "cameras.npz", **matrices)

    return damage


def _mask(array: np.ndarray) -> Callable[[Path], None]:
    return lambda folder: Image.fromarray(array).save(folder / "mask" / "001.png")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda f: (f / "cameras.npz").unlink(), "expected the cameras in cameras_sphere.npz or"),
        (_npz(lambda m: m.pop("world_mat_7")), "1 missing .first: world_mat_7"),
        (_npz(lambda m: m["world_mat_7"].fill(np.nan)), "world_mat_7: .* got NaN or infinity"),
        (_npz(lambda m: m["world_mat_7"].__iadd__(100 * np.eye(4, k=1))), "got a skew of"),
        (lambda f: (f / "mask" / "048.png").unlink(), "a mask for each of 49 photos, got 48"),
        (lambda f: (f / "image/000003.png").rename(f / "image/a.png"), "positions .* got a.png"),
        (_mask(np.zeros((HEIGHT, WIDTH), np.uint8)), "expected some white pixels in a mask"),
        (_mask(np.full((20, 20), 255, np.uint8)), "expected a mask of the photo's 40x30 .* 20x20"),
    ],
)
def test_damaged_folders(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    damage(write_dtu(tmp_path))
    with pytest.raises(UserError, match=message) as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["dtu_scan24", "dtu_scan65"])
def test_real_scans_agree_with_their_colmap_model(name: str) -> None:
    """Cameras from the projections equal those of the model, made independently of this code."""
    folder = open_scene(name)
    scene = load_scene("dtu", {"path": str(folder), "n_views": 9})
    twin = load_scene("colmap", {"path": str(folder), "split": "dtu", "n_views": 9})
    for a, b in zip(
        (*scene.training.views, *scene.test), (*twin.training.views, *twin.test), strict=True
    ):
        assert torch.allclose(a.camera.viewmat, b.camera.viewmat, atol=1e-2)  # millimetres
        assert torch.allclose(a.camera.K, b.camera.K, atol=1e-2)
        assert torch.equal(a.image, b.image)
    assert torch.equal(scene.training.points.xyz, twin.training.points.xyz)
    assert (scene.training.points.visible.sum(1) >= 2).all()
    assert 300 < scene.training.extent < 600
