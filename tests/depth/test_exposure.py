"""Photos that were exposed differently: gains are found from shared surfaces, and new views are
exposed like the photos around them."""

import csv
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.depth.exposure import Exposures, find_exposures
from framework.records.progress import Silent
from framework.run import preparation
from framework.run.experiment import run_experiment
from framework.scenes import Embedded
from framework.types import DepthMap, Scene, View
from tests.built import load_scene
from tests.cli.test_config import composed
from tests.depth import plane

PLACES = ((-0.6, 0, 0), (0, 0.1, 0), (0.5, 0, 0.1), (0.2, -0.4, 0), (-0.3, 0.2, 0), (0.3, 0.3, 0))
GAINS = np.array(
    [
        *([0.1, 0.05, 0.2], [-0.15, 0.0, -0.1], [0.05, -0.1, -0.1]),
        *([0.0, 0.05, 0.0], [0.1, 0.1, 0.1], [-0.05, 0.0, 0.1]),
    ]
)
SIZES = ((96, 72), (90, 70), (96, 72), (80, 60), (96, 72), (96, 72))


def views() -> list[View]:
    """Photos of the plane, dark enough for a gain."""
    cameras = [plane.camera(p, s, 110.0) for p, s in zip(PLACES, SIZES, strict=True)]
    seen = [plane.view(str(i), camera) for i, camera in enumerate(cameras)]
    return [replace(view, image=0.2 + 0.5 * view.image) for view in seen]


def exposed(photos: Sequence[View], log_gains: np.ndarray) -> list[View]:
    factors = torch.from_numpy(np.exp(log_gains)).float()[:, :, None, None]
    return [replace(v, image=v.image * f) for v, f in zip(photos, factors, strict=True)]


def depths(photos: Sequence[View]) -> list[DepthMap]:
    actual = [torch.from_numpy(plane.plane_depth(view.camera)).float() for view in photos]
    return [DepthMap(depth, torch.ones_like(depth)) for depth in actual]


def test_the_gains_are_found_and_taken_out() -> None:
    photos = views()
    actual = find_exposures(exposed(photos, GAINS), depths(photos))
    assert actual is not None
    assert actual.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.01)
    common = torch.from_numpy(np.exp(GAINS.mean(0))).float()[:, None, None]
    for view, evened in zip(photos, actual.evened(exposed(photos, GAINS)), strict=True):
        assert torch.allclose(evened.image, view.image * common, rtol=0.02)
    assert "root mean square 9 %" in actual.message()


def test_spoiled_depth_does_not_change_the_photos(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stress study spoils the depth alone."""
    asked: list[Sequence[DepthMap]] = []
    monkeypatch.setattr(preparation, "find_exposures", lambda _, depth: asked.append(depth))
    words = ("scene.width=64", "scene.height=48", "scene.n_views=6")
    for spoil in ((), ("depth.corruption=bias", "depth.strength=0.5")):
        config = composed(*words, *spoil)
        keys = [preparation.options_of(config, group) for group in ("scene", "depth")]
        preparation.compare_exposures(*keys, "")
        maps = preparation.estimate_depth(*keys, "").result
        assert (maps is asked[-1]) == (not spoil)
    assert all(torch.equal(a.depth, b.depth) for a, b in zip(*asked, strict=True))
    preparation.forget()  # what the stand-in answered


def test_a_new_view_is_exposed_as_the_photos_around_it() -> None:
    cameras = tuple(plane.camera((x, 0, 0), (8, 6), 10.0) for x in (0.0, 1.0, 5.0))
    actual = Exposures(cameras, np.array([[0.3] * 3, [-0.1] * 3, [-0.2] * 3]))
    assert actual.at(cameras[1]) == pytest.approx([-0.1] * 3, abs=1e-4)
    middle = plane.camera((0.5, 0, 0), (8, 6), 10.0)
    weights = np.array([1 / 0.5**2, 1 / 0.5**2, 1 / 4.5**2])
    mean = (weights * [0.3, -0.1, -0.2]).sum() / weights.sum()
    assert actual.at(middle) == pytest.approx([mean] * 3, abs=1e-4)
    grey = torch.full((3, 6, 8), 0.5)
    assert torch.allclose(actual.applied(grey, middle), grey * np.exp(mean), atol=1e-4)
    assert actual.factors(middle) == pytest.approx([np.exp(mean)] * 3, abs=1e-4)


def test_a_run_evens_the_photos_and_tests_as_they_were_exposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = load_scene("embedded", {"width": 128, "height": 96, "n_views": 6})
    gains = 1.5 * GAINS
    of = Exposures(tuple(view.camera for view in original.training.views), gains)

    def uneven(_: Embedded) -> Scene:
        seen = exposed(original.training.views, gains)
        tests = [replace(v, image=of.applied(v.image, v.camera)) for v in original.test]
        training = replace(original.training, views=tuple(seen))
        return replace(original, training=training, test=tuple(tests), fingerprint="0" * 64)

    results: dict[str, float] = {}
    words = (
        "scene.width=128",
        "scene.height=96",
        "scene.n_views=6",
        "trainer.steps=40",
        "metrics.lpips_weights=none",
    )
    preparation.forget()
    monkeypatch.setattr(Embedded, "load", uneven)
    for evened in ("true", "false"):
        config = composed(*words, f"trainer.exposure={evened}")
        folder = tmp_path / evened
        record = run_experiment(config, folder, Silent())
        assert ("exposure_rms" in record.provenance) == (evened == "true")
        psnr = record.summary["psnr"]
        assert isinstance(psnr, float)
        results[evened] = psnr
        last = (folder / "history.csv").read_text(encoding="utf-8").splitlines()
        message = [float(row["test_psnr"]) for row in csv.DictReader(last) if row["test_psnr"]]
        assert message[-1] == pytest.approx(psnr, abs=0.05)
        frames = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))["frames"]
        assert all(("exposure" in frame) == (evened == "true") for frame in frames)
        factors = [frame["exposure"] for frame in frames[:6] if "exposure" in frame]
        if factors:
            assert np.log(factors) == pytest.approx(gains - gains.mean(0), abs=0.03)
    preparation.forget()
    assert results["true"] > results["false"] + 0.3
