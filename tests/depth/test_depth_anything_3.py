"""Depth Anything 3 behind a stand-in that keeps the package's conventions for poses and shapes."""

from __future__ import annotations

import builtins
import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from framework.depth.network import load_network, normalised_poses
from framework.errors import UserError
from framework.types import Camera, TrainingSet
from tests.built import build_provider
from tests.depth.plane import NORMAL, OFFSET, camera, plane_depth, plane_scene, view

NETWORK_SIZE = (56, 84)  # multiples of 14, near the aspect ratio of the views


def equal_views(n_points: int = 100) -> TrainingSet:
    """The plane scene with views of one size, which the package wants."""
    scene = plane_scene(n_points)
    views = (
        *(scene.views[i] for i in (0, 2)),
        view("middle.JPG", camera((0.0, 0.2, 0.1), (96, 72), 88.0)),
    )
    return replace(scene, views=views)


@dataclass
class Answer:
    depth: Any
    conf: Any
    extrinsics: Any
    sky: Any = None


class StandIn:
    """Ray-traces the plane of `tests.depth.plane` for whatever cameras it is given, as the network
    would see it: at its own size, times an unknown `factor`."""

    def __init__(self, world: Camera, unit: float, factor: float = 1.0) -> None:
        self.world, self.unit, self.factor = world, unit, factor  # the given world's first camera
        self.calls: list[dict[str, Any]] = []
        self.change: Callable[[Answer], None] = lambda answer: None

    def to(self, device: torch.device) -> StandIn:
        self.device = device
        return self

    def eval(self) -> StandIn:
        return self

    def inference(
        self,
        image: list[np.ndarray],
        extrinsics: np.ndarray | None = None,
        intrinsics: np.ndarray | None = None,
        align_to_input_ext_scale: bool = True,
        process_res: int = 504,
    ) -> Answer:
        assert extrinsics is not None and intrinsics is not None
        assert all(i.dtype == np.uint8 and i.shape == image[0].shape for i in image)
        self.calls.append({"image": image, "extrinsics": extrinsics, "process_res": process_res})
        height, width = image[0].shape[:2]
        depth = [
            self._trace(pose, K, width, height)
            for pose, K in zip(extrinsics.astype(float), intrinsics.astype(float), strict=True)
        ]
        stack = np.stack(depth).astype(np.float32) * self.factor
        answer = Answer(stack, np.full_like(stack, 4.0), extrinsics[:, :3].copy())
        self.change(answer)
        return answer

    def _trace(self, pose: np.ndarray, K: np.ndarray, width: int, height: int) -> np.ndarray:
        """z in the given unit, from the first camera's true place: a relative pose is all it is."""
        first = self.calls[-1]["extrinsics"][0].astype(float)
        relative = pose @ np.linalg.inv(first)
        relative[:3, 3] *= self.unit
        true = relative @ self.world.viewmat.numpy()
        h, w = NETWORK_SIZE
        y, x = np.mgrid[:h, :w] + 0.5
        pixels = np.stack([x * width / w, y * height / h, np.ones_like(x)], -1)
        rays = pixels @ np.linalg.inv(K).T @ true[:3, :3]
        center = -true[:3, :3].T @ true[:3, 3]
        depth: np.ndarray = (OFFSET - NORMAL @ center) / (rays @ NORMAL) / self.unit
        return depth


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    (tmp_path / "config.json").write_text("{}")
    (tmp_path / "model.safetensors").write_bytes(b"weights")
    return tmp_path


def install(monkeypatch: pytest.MonkeyPatch, network: StandIn) -> list[str]:
    """Put the stand-in where the package would be; returns what it was asked to load."""
    loaded: list[str] = []

    def from_pretrained(folder: str) -> StandIn:
        loaded.append(folder)
        return network

    package, api = ModuleType("depth_anything_3"), ModuleType("depth_anything_3.api")
    api.DepthAnything3 = SimpleNamespace(from_pretrained=from_pretrained)  # type: ignore[attr-defined]
    package.api = api  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "depth_anything_3", package)
    monkeypatch.setitem(sys.modules, "depth_anything_3.api", api)
    load_network.cache_clear()
    return loaded


def stand_in(scene: TrainingSet, factor: float = 1.0) -> StandIn:
    return StandIn(scene.views[0].camera, normalised_poses(scene)[1], factor)


def provider(weights: Path, **options: object) -> Any:
    return build_provider("depth_anything_3", {"weights": str(weights), **options})


@pytest.mark.parametrize(
    ("align", "factor"), [("points", 3.7), ("plane_sweep", 0.2), ("none", 1.0)]
)
def test_depth_comes_back_in_scene_units(
    monkeypatch: pytest.MonkeyPatch, weights: Path, align: str, factor: float
) -> None:
    scene = equal_views()
    network = stand_in(scene, factor)
    loaded = install(monkeypatch, network)
    maps = provider(weights, align=align, process_res=280).estimate(scene)
    assert loaded == [str(weights)] and network.device == torch.device("cpu")
    assert network.calls[0]["process_res"] == 280
    for actual, of in zip(maps, scene.views, strict=True):
        assert actual.depth.shape == actual.confidence.shape == of.image.shape[1:]
        assert actual.depth.dtype == actual.confidence.dtype == torch.float32
        error = np.abs(actual.depth.numpy() / plane_depth(of.camera) - 1)
        assert np.median(error) < 0.005 and (error < 0.02).mean() > 0.99
        confident = actual.confidence.numpy()
        assert confident.max() == pytest.approx(0.75) and (confident > 0).mean() > 0.8


def test_without_the_package_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, weights: Path
) -> None:
    original = builtins.__import__

    def absent(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.split(".")[0] == "depth_anything_3":
            raise ModuleNotFoundError("No module named 'depth_anything_3'")
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", absent)
    load_network.cache_clear()
    for call in ("estimate", "fingerprint"):
        with pytest.raises(
            UserError, match=r"pip install git\+https://\S+Depth-Anything-3"
        ) as error:
            getattr(provider(weights), call)(equal_views())
        assert "\n" not in str(error.value)


def test_the_fingerprint_follows_the_weights(
    monkeypatch: pytest.MonkeyPatch, weights: Path
) -> None:
    scene = equal_views()
    install(monkeypatch, stand_in(scene))
    first = provider(weights).fingerprint(scene)
    assert first == provider(weights).fingerprint(scene) and len(first) == 64
    (weights / "model.safetensors").write_bytes(b"others, and longer")
    assert provider(weights).fingerprint(scene) not in (first, hashlib.sha256().hexdigest())
