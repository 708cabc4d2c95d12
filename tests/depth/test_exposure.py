"""Photos that were exposed differently: gains are found from shared surfaces, and new views are
exposed like the photos around them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from framework.depth.exposure import Exposures, find_exposures
from framework.records.progress import Silent
from framework.run import experiment
from framework.scenes import load_scene
from framework.types import DepthMap, Scene, View
from tests.cli.test_config import composed
from tests.depth import plane

PLACES = ((-0.6, 0, 0), (0, 0.1, 0), (0.5, 0, 0.1), (0.2, -0.4, 0))
GAINS = np.array([[0.1, 0.05, 0.2], [-0.15, 0.0, -0.1], [0.05, -0.1, -0.1], [0.0, 0.05, 0.0]])
SIZES = ((96, 72), (90, 70), (96, 72), (80, 60))


def views() -> list[View]:
    """Photos of the plane, dark enough for a gain."""
    cameras = [plane.camera(p, s, 110.0) for p, s in zip(PLACES, SIZES, strict=True)]
    seen = [plane.view(str(i), camera) for i, camera in enumerate(cameras)]
    return [replace(view, image=0.2 + 0.5 * view.image) for view in seen]


def exposed(photos: Sequence[View], log_gains: np.ndarray) -> list[View]:
    factors = torch.from_numpy(np.exp(log_gains)).float()[:, :, None, None]
    return [replace(v, image=v.image * f) for v, f in zip(photos, factors, strict=True)]


def depths(photos: Sequence[View]) -> list[DepthMap]:
    found = [torch.from_numpy(plane.plane_depth(view.camera)).float() for view in photos]
    return [DepthMap(depth, torch.ones_like(depth)) for depth in found]


def test_the_gains_are_found_and_taken_out() -> None:
    photos = views()
    found = find_exposures(exposed(photos, GAINS), depths(photos))
    assert found is not None
    assert found.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.01)
    common = torch.from_numpy(np.exp(GAINS.mean(0))).float()[:, None, None]
    for view, evened in zip(photos, found.evened(exposed(photos, GAINS)), strict=True):
        assert torch.allclose(evened.image, view.image * common, rtol=0.02)
    assert "root mean square 10 %" in found.told()


def test_wrong_depth_in_places_and_highlights_hardly_matter() -> None:
    photos = views()
    maps = depths(photos)
    for each in maps:
        each.depth[:20] *= 1.3  # no other photo confirms it
        each.confidence[40:50] = 0
    shiny = exposed(photos, GAINS)
    shiny[1].image[:, 30:45, 30:50] += 0.2
    found = find_exposures(shiny, maps)
    assert found is not None
    assert found.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.03)


def test_nothing_is_changed_where_there_is_nothing_to_mend_or_to_see() -> None:
    photos = views()
    assert find_exposures(exposed(photos, 0.05 * GAINS), depths(photos)) is None
    assert find_exposures(photos[:1], depths(photos)[:1]) is None
    unknown = [DepthMap(torch.zeros_like(d.depth), d.confidence) for d in depths(photos)]
    assert find_exposures(exposed(photos, GAINS), unknown) is None
    dark = [replace(view, image=0.02 * view.image) for view in photos]
    assert find_exposures(exposed(dark, GAINS), depths(photos)) is None


def test_a_photo_that_shares_nothing_is_left_as_it_is() -> None:
    photos = views()
    maps = depths(photos)
    maps[3] = DepthMap(torch.zeros_like(maps[3].depth), maps[3].confidence)
    found = find_exposures(exposed(photos, GAINS), maps)
    assert found is not None and found.log_gains[3].tolist() == [0, 0, 0]
    assert found.log_gains[:3] == pytest.approx(GAINS[:3] - GAINS[:3].mean(0), abs=0.01)


def test_a_new_view_is_exposed_as_the_photos_around_it() -> None:
    cameras = tuple(plane.camera((x, 0, 0), (8, 6), 10.0) for x in (0.0, 1.0, 5.0))
    found = Exposures(cameras, np.array([[0.3] * 3, [-0.1] * 3, [-0.2] * 3]))
    assert found.at(cameras[1]) == pytest.approx([-0.1] * 3, abs=1e-4)
    middle = plane.camera((0.5, 0, 0), (8, 6), 10.0)
    weights = np.array([1 / 0.5**2, 1 / 0.5**2, 1 / 4.5**2])
    mean = (weights * [0.3, -0.1, -0.2]).sum() / weights.sum()
    assert found.at(middle) == pytest.approx([mean] * 3, abs=1e-4)
    grey = torch.full((3, 6, 8), 0.5)
    assert torch.allclose(found.applied(grey, middle), grey * np.exp(mean), atol=1e-4)
    assert found.factors(middle) == pytest.approx([np.exp(mean)] * 3, abs=1e-4)


def test_a_run_evens_the_photos_and_tests_as_they_were_exposed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = load_scene("embedded", {"width": 128, "height": 96})
    gains = np.array([[0.2, 0.1, 0.15], [0.0, 0.1, 0.0], [-0.2, -0.2, -0.15]])
    of = Exposures(tuple(view.camera for view in original.training.views), gains)

    def uneven(name: str, options: object) -> Scene:
        seen = exposed(original.training.views, gains)
        tests = [replace(v, image=of.applied(v.image, v.camera)) for v in original.test]
        training = replace(original.training, views=tuple(seen))
        return replace(original, training=training, test=tuple(tests), fingerprint="0" * 64)

    results: dict[str, float] = {}
    words = ("scene.width=128", "scene.height=96", "trainer.steps=40", "metrics.lpips_weights=none")
    experiment._scene.cache_clear()
    monkeypatch.setattr(experiment, "load_scene", uneven)
    for evened in ("true", "false"):
        config = composed(*words, f"trainer.exposure={evened}")
        folder = tmp_path / evened
        record = experiment.run_experiment(config, folder, Silent())
        assert ("exposure_rms" in record.provenance) == (evened == "true")
        psnr = record.summary["psnr"]
        assert isinstance(psnr, float)
        results[evened] = psnr
        frames = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))["frames"]
        assert all(("exposure" in frame) == (evened == "true") for frame in frames)
        factors = [frame["exposure"] for frame in frames[:3] if "exposure" in frame]
        if factors:
            assert np.log(factors) == pytest.approx(gains - gains.mean(0), abs=0.03)
    experiment._scene.cache_clear()
    assert results["true"] > results["false"] + 0.3
