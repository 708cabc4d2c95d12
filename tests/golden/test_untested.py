"""A tiny run on every photo of a folder, from the command to the report."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from framework.command.cli import main
from framework.metrics.values import METRICS, Missing
from framework.records.record import read_run
from tests.built import load_scene

TINY = "trainer.steps=6 init.budget=500 depth.planes=24 metrics.lpips_weights=none threads=1"


def write_photos(folder: Path) -> list[str]:
    """The embedded scene's training views, small, with their `transforms.json`."""
    scene = load_scene("embedded", {"width": 64, "height": 48, "supersampling": 1, "n_views": 4})
    views, frames = scene.training.views, []
    for i, view in enumerate(views):
        pixels = (view.image.numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
        Image.fromarray(pixels).save(folder / f"{i}.png")
        pose = np.linalg.inv(view.camera.viewmat.numpy()) @ np.diag([1.0, -1.0, -1.0, 1.0])
        frames.append({"file_path": f"{i}.png", "transform_matrix": pose.tolist()})
    K = views[0].camera.K
    lens = {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), "w": 64, "h": 48}
    lens |= {"cx": float(K[0, 2]), "cy": float(K[1, 2])}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    bounds = {"near": scene.training.near, "far": scene.training.far}
    return [f"scene.{name}={bound}" for name, bound in bounds.items()]


@pytest.mark.parametrize("n_views", ["all", "2"])
def test_every_photo_trains_and_nothing_is_tested(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    n_views: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    photos = tmp_path / "photos"
    photos.mkdir()
    bounds = write_photos(photos)
    line = f"scene=transforms scene.path=photos scene.n_views={n_views} scene.split=none {TINY}"
    for reused in (False, True):
        assert main([*line.split(), *bounds]) == 0
        *message, page, report = capsys.readouterr().out.splitlines()
        (last,) = (line for line in message if " · not tested (scene.split=none) · " in line)
        assert ("reused" in last) == reused
    study = Path("reports") / f"transforms_photos_{n_views}v_untested"
    assert message[-1] == f"view: fishersplat view {study}"
    assert page == f"page: {study}/report.html"
    assert report == f"report: {study}/report.md"
    assert "Nothing was tested: no photo was held out" in Path(study, "report.md").read_text(
        encoding="utf-8"
    )
    (folder,) = (study / "runs").iterdir()
    run = read_run(folder)
    assert run.record.scene is not None
    names = [f"{i}.png" for i in range(4)]
    assert list(run.record.scene.training) == (names if n_views == "all" else ["0.png", "3.png"])
    assert run.record.scene.test == ()
    assert run.record.summary == {name: Missing("no test views") for name in METRICS}
    assert np.isnan(run.history.numbers["test_psnr"]).all()
