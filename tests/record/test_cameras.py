"""`cameras.json` and `transforms.json`: read back, they are the run's cameras."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from framework.records.cameras import CAMERAS, TRANSFORMS, write_cameras
from framework.scenes.transforms_file import read_frames
from tests.built import load_scene
from tests.scenes.synthetic import write_scene


def test_both_files_give_the_cameras_back(tmp_path: Path) -> None:
    scene = load_scene("colmap", {"path": str(write_scene(tmp_path / "scene")), "n_views": 3})
    views = [*scene.test, *scene.training.views]
    write_cameras(tmp_path, scene.training.views, scene.test, near=0.25)

    listed = json.loads((tmp_path / CAMERAS).read_text())
    assert [entry["id"] for entry in listed] == list(range(len(views)))
    for entry, view in zip(listed, views, strict=True):
        assert list(entry) == [
            *("id", "img_name", "width", "height", "position", "rotation", "fy", "fx")
        ]
        assert entry["img_name"] == view.name
        assert (entry["width"], entry["height"]) == (view.camera.width, view.camera.height)
        assert (entry["fx"], entry["fy"]) == (view.camera.K[0, 0], view.camera.K[1, 1])
        ahead = np.array(entry["position"]) + np.array(entry["rotation"]) @ [0, 0, 2.0]
        seen = view.camera.viewmat[:3, :3].numpy() @ ahead + view.camera.viewmat[:3, 3].numpy()
        assert seen == pytest.approx([0, 0, 2.0], abs=1e-12)

    for view in views:  # our own reader wants the photos beside
        Image.new("RGB", (view.camera.width, view.camera.height)).save(tmp_path / view.name)
    frames = {frame.name: frame for frame in read_frames(tmp_path / TRANSFORMS)}
    assert set(frames) == {view.name for view in views}
    for view in views:
        frame = frames[view.name]
        lens = frame.lens(view.camera.width, view.camera.height)
        assert torch.allclose(torch.from_numpy(frame.viewmat), view.camera.viewmat)
        K = view.camera.K
        assert [lens.fx, lens.fy, lens.cx, lens.cy] == [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    message = json.loads((tmp_path / TRANSFORMS).read_text())
    assert message["train_filenames"] == [view.name for view in scene.training.views]
    assert message["test_filenames"] == [view.name for view in scene.test]
    assert message["near_plane"] == 0.25
    assert "exposure" not in message["frames"][0]
    test = scene.test[0].camera
    write_cameras(
        tmp_path,
        scene.training.views,
        scene.test,
        near=0.25,
        exposure=lambda camera: [1.5 if camera is test else 1.0] * 3,
    )
    frames_told = json.loads((tmp_path / TRANSFORMS).read_text())["frames"]
    lit = {frame["file_path"]: frame["exposure"] for frame in frames_told}
    assert lit.pop(scene.test[0].name) == [1.5] * 3
    assert all(factors == [1.0] * 3 for factors in lit.values())
