"""The embedded scene: pinned bits, exact geometry, the cache, the options."""

import hashlib
from pathlib import Path

import pytest
import torch

from framework.scenes.embedded import generate
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


def test_points_are_exact_and_supported(scene: Scene) -> None:
    points = scene.training.points
    assert len(points.xyz) > 1000
    assert (points.visible.sum(1) >= 2).all()
    for k, view in enumerate(scene.training.views):
        seen, _ = seen_by(view, points.xyz)
        assert torch.equal(seen, points.visible[:, k])


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
