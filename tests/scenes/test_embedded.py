"""The embedded scene: pinned bits, exact geometry, the cache, the options."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.compute.parallel import set_threads
from framework.errors import UserError
from framework.scenes import Embedded
from framework.scenes.embedded import generate, rig
from framework.types import Scene, View
from tests.built import load_scene

IMAGES_SHA256 = "d3b1dcd952fa907d8c915271f18a2c116cd6fd88c1b595f41a07c83b02fbde4c"
SMALL = {"width": 64, "height": 48, "supersampling": 2}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, cache: Path) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(cache))


@pytest.fixture(scope="module")
def scene(cache: Path) -> Scene:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FISHERSPLAT_CACHE", str(cache))
        return load_scene("embedded", {})


def test_default_bits_are_pinned(scene: Scene) -> None:
    """Images and depths, on every machine; on purpose not the fingerprint, which has names too."""
    digest = hashlib.sha256()
    for view in (*scene.training.views, *scene.test):
        assert view.depth is not None
        digest.update((view.image * 255).round().to(torch.uint8).numpy().tobytes())
        digest.update(view.depth.numpy().tobytes())
    assert digest.hexdigest() == IMAGES_SHA256


def test_default_shape(scene: Scene) -> None:
    assert scene.protocol == "rig"
    assert [v.name for v in scene.training.views] == ["train00", "train01", "train02"]
    assert scene.training.views[0].image.shape == (3, 240, 320)
    tags = [v.tags for v in scene.test]
    assert tags.count(("interpolating",)) == 4 and tags.count(("extrapolating",)) == 4
    for view in (*scene.training.views, *scene.test):
        assert view.depth is not None
        depth = view.depth
        assert scene.training.near < float(depth.min()) < 2.5
        assert 7.0 < float(depth.max()) < scene.training.far
        assert float(view.image.std()) > 0.15


def lift(view: View) -> torch.Tensor:
    """[H, W, 3] world points at the pixel centres."""
    assert view.depth is not None
    camera, z = view.camera, view.depth.double()
    v, u = torch.meshgrid(
        torch.arange(camera.height) + 0.5, torch.arange(camera.width) + 0.5, indexing="ij"
    )
    rays = torch.stack([u, v, torch.ones_like(u)], dim=-1).double() @ torch.linalg.inv(camera.K).T
    return (rays * z[..., None] - camera.viewmat[:3, 3]) @ camera.viewmat[:3, :3]


def seen_by(view: View, xyz: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Which points the view sees (its depth agrees within 1 %) and the pixel indices."""
    assert view.depth is not None
    camera = view.camera
    pixel = (xyz @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]) @ camera.K.T
    u, v = (pixel[..., :2] / pixel[..., 2:]).floor().long().unbind(-1)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    index = v.clamp(0, camera.height - 1) * camera.width + u.clamp(0, camera.width - 1)
    z = pixel[..., 2]
    return inside & ((view.depth.flatten()[index] - z).abs() < 0.01 * z), index


def test_depth_poses_and_images_agree(scene: Scene) -> None:
    """A pixel lifted by its depth has the same colour where another camera sees it."""
    first, second = scene.training.views[0], scene.training.views[2]
    seen, index = seen_by(second, lift(first))
    difference = (second.image.flatten(1)[:, index] - first.image).abs().mean(0)[seen]
    assert 0.7 < float(seen.float().mean()) < 0.9  # overlap of the outermost cameras
    assert float(difference.median()) < 0.03


def test_known_depth_of_the_back_wall(scene: Scene) -> None:
    """The wall's plane is z = 7.5: the points lifted from its pixels lie on it."""
    wall = (lift(scene.test[0])[..., 2] - 7.5).abs() < 1e-6
    assert 0.15 < float(wall.float().mean()) < 0.6


def test_points_are_exact_and_supported(scene: Scene) -> None:
    points = scene.training.points
    assert len(points.xyz) > 1000
    assert (points.visible.sum(1) >= 2).all()
    for k, view in enumerate(scene.training.views):
        seen, _ = seen_by(view, points.xyz)
        assert torch.equal(seen, points.visible[:, k])


def test_same_bits_on_any_thread_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    prints = set()
    try:
        for n in (1, 2, 3):
            monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path / str(n)))
            set_threads(n)
            prints.add(load_scene("embedded", SMALL).fingerprint)
    finally:
        set_threads(0)
    assert len(prints) == 1


def test_same_bits_on_a_plain_processor(tmp_path: Path) -> None:
    """Compiled for a machine without wide vectors or fused multiply-add, the bits are the same."""
    code = (
        f"from tests.built import load_scene;print(load_scene('embedded', {SMALL!r}).fingerprint)"
    )
    env = {**os.environ, "NUMBA_CPU_NAME": "generic", "FISHERSPLAT_CACHE": str(tmp_path)}
    env["NUMBA_CPU_FEATURES"] = ""
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == load_scene("embedded", SMALL).fingerprint


def test_cache_is_used_and_a_damaged_one_replaced(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("FISHERSPLAT_CACHE", str(tmp_path))
    first = load_scene("embedded", SMALL).fingerprint
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr(generate, "_render", lambda options: pytest.fail("not read from the cache"))
        assert load_scene("embedded", SMALL).fingerprint == first
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 1]) + whole[middle + 1 :]
    for damaged in (b"", b"no zip", whole[: len(whole) // 3], flipped):
        file.write_bytes(damaged)
        assert load_scene("embedded", SMALL).fingerprint == first
        assert "damaged" in caplog.text
        assert file.read_bytes() == whole
        caplog.clear()
    assert [f.name for f in tmp_path.iterdir()] == [file.name]


def test_each_option_has_its_own_scene() -> None:
    changes = [{"texture": 0.3}, {"gloss": 0.0}, {"spread": 0.5}, {"n_views": 4}]
    prints = {load_scene("embedded", SMALL | c).fingerprint for c in [{}, *changes]}
    assert len(prints) == 5


def test_texture_and_gloss_act_as_they_say() -> None:
    def image(**change: float) -> torch.Tensor:
        return load_scene("embedded", SMALL | change).training.views[0].image

    def detail(x: torch.Tensor) -> float:
        return float((x[:, :, 1:] - x[:, :, :-1]).abs().mean())

    assert detail(image(texture=0.0)) < 0.8 * detail(image())
    assert 0.001 < float((image(gloss=0.0) - image()).abs().mean()) < 0.1


@pytest.mark.parametrize("n", [1, 2, 3, 4, 7, 24])
def test_rig_marks_what_lies_between_the_cameras(n: int) -> None:
    train = rig.training_positions(n)
    assert len(set(train)) == n
    assert not set(train) & set(rig.TEST_POSITIONS)
    inside = [rig.is_inside(p, train) for p in rig.TEST_POSITIONS]
    assert sum(inside) == {1: 0, 2: 1}.get(n, 4) or n > 3
    assert not any(inside[4:])
    assert all(rig.is_inside(p, train) for p in train) or n == 1


def test_poses_are_rotations_that_look_ahead(scene: Scene) -> None:
    for view in (*scene.training.views, *scene.test):
        R = view.camera.viewmat[:3, :3]
        assert torch.allclose(R @ R.T, torch.eye(3, dtype=torch.float64), atol=1e-12)
        assert float(torch.linalg.det(R)) == pytest.approx(1.0)
        assert float(R[2, 2]) > 0.9
    assert np.allclose(scene.training.views[1].camera.center, [0, 0.5 * Embedded().spread, 0])


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("n_views", 65),
        ("width", 8),
        ("height", 5000),
        ("supersampling", 0),
        ("spread", 0.0),
        ("texture", -0.1),
        ("gloss", 9.0),
    ],
)
def test_options_out_of_range(option: str, value: float) -> None:
    with pytest.raises(UserError, match=rf"scene.{option}: expected .*, got {value}"):
        dataclasses.replace(Embedded(), **{option: value})


def test_pose_noise_tells_training_poses_wrong_and_nothing_else(scene: Scene) -> None:
    wrong = load_scene("embedded", {"pose_noise": 2.0})
    assert wrong.fingerprint != scene.fingerprint
    for message, true in zip(wrong.test, scene.test, strict=True):
        assert torch.equal(message.camera.viewmat, true.camera.viewmat)
    for message, true in zip(wrong.training.views, scene.training.views, strict=True):
        assert torch.equal(message.image, true.image)
        turn = message.camera.viewmat[:3, :3]
        assert torch.allclose(turn @ turn.T, torch.eye(3, dtype=turn.dtype), atol=1e-12)
        assert not torch.equal(message.camera.viewmat, true.camera.viewmat)


def test_pose_noise_is_as_large_as_it_says() -> None:
    """Rms shift of a point at the focus: a turn and a move of `angle` each, hence sqrt(2) angle."""
    angle = 0.01
    poses = np.stack([rig.pose((0.0, 0.0, 0.0), 0.35)] * 400)
    point = np.array([*rig.FOCUS])

    def on_screen(pose: np.ndarray) -> np.ndarray:
        seen = (point - pose[:, 3]) @ pose[:, :3]
        return seen[:2] / seen[2]

    shifts = np.array([on_screen(p) for p in rig.perturbed(poses, angle)]) - on_screen(poses[0])
    assert np.sqrt((shifts**2).mean(axis=0)) == pytest.approx(2**0.5 * angle, rel=0.12)
