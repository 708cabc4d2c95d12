"""Photos that were exposed differently: gains are found from shared surfaces, and new views are
exposed like the photos around them."""

from __future__ import annotations

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


def test_wrong_depth_in_places_and_highlights_hardly_matter() -> None:
    photos = views()
    maps = depths(photos)
    for each in maps:
        each.depth[:20] *= 1.3  # no other photo confirms it
        each.confidence[40:50] = 0
    shiny = exposed(photos, GAINS)
    shiny[1].image[:, 30:45, 30:50] += 0.2
    actual = find_exposures(shiny, maps)
    assert actual is not None
    assert actual.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.03)


def test_colours_that_scatter_are_believed_less() -> None:
    """As where far views match wrongly: blue gets a random pattern in each photo."""
    photos, draws = exposed(views(), GAINS), np.random.default_rng(0)
    for view in photos:
        blocks = draws.uniform(-0.25, 0.25, (view.image.shape[1] // 6 + 1, 17))
        pattern = np.kron(blocks, np.ones((6, 6)))[: view.image.shape[1], : view.image.shape[2]]
        view.image[2] = (view.image[2] + torch.from_numpy(pattern).float()).clamp(0.05, 0.95)
    actual = find_exposures(photos, depths(photos))
    assert actual is not None
    exact = GAINS - GAINS.mean(0)
    assert actual.log_gains[:, :2] == pytest.approx(exact[:, :2], abs=0.01)
    assert 0.3 < (actual.log_gains[:, 2] * exact[:, 2]).sum() / (exact[:, 2] ** 2).sum() < 0.8


def test_nothing_is_changed_where_there_is_nothing_to_mend_or_to_see() -> None:
    photos = views()
    assert find_exposures(exposed(photos, 0.05 * GAINS), depths(photos)) is None
    few = exposed(photos, GAINS)[:5]
    assert find_exposures(few, depths(few)) is None
    unknown = [DepthMap(torch.zeros_like(d.depth), d.confidence) for d in depths(photos)]
    assert find_exposures(exposed(photos, GAINS), unknown) is None
    dark = [replace(view, image=0.02 * view.image) for view in photos]
    assert find_exposures(exposed(dark, GAINS), depths(photos)) is None


def test_many_photos_in_a_row_keep_their_drift() -> None:
    """Each is compared with its neighbours alone, and the prior must not hold the whole back."""
    cameras = [plane.camera((0.04 * x, 0, 0), (40, 30), 45.0) for x in range(-20, 20)]
    seen = [plane.view(str(i), camera) for i, camera in enumerate(cameras)]
    photos = [replace(view, image=0.2 + 0.3 * view.image) for view in seen]
    drift = np.linspace(-0.4, 0.4, len(photos))[:, None].repeat(3, axis=1)
    actual = find_exposures(exposed(photos, drift), depths(photos))
    assert actual is not None and actual.log_gains == pytest.approx(drift, abs=0.02)


def test_what_a_mask_hides_does_not_count() -> None:
    photos = exposed(views(), GAINS)
    mask = torch.ones_like(photos[0].image[0])
    mask[:50] = 0
    spoiled = photos[0].image.clone()
    spoiled[:, :50] *= 0.5
    photos[0] = replace(photos[0], image=spoiled, mask=mask)
    actual = find_exposures(photos, depths(photos))
    assert actual is not None
    assert actual.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.02)


@pytest.mark.parametrize("hidden", [0.0, 1.0])
def test_beside_a_mask_its_colours_do_not_count_either(hidden: float) -> None:
    """Colours are means over 5 x 5 pixels, of which stripes hide half everywhere."""
    photos = exposed(views(), GAINS)
    for k, view in enumerate(photos):
        mask = torch.ones_like(view.image[0])
        for first in range(0, mask.shape[0], 12):
            mask[first : first + 6] = 0
        image = torch.where(mask > 0.5, view.image, torch.tensor(hidden))
        photos[k] = replace(view, image=image, mask=mask)
    actual = find_exposures(photos, depths(photos))
    assert actual is not None
    assert actual.log_gains == pytest.approx(GAINS - GAINS.mean(0), abs=0.01)


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
