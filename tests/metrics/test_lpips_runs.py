"""LPIPS in runs: measured from what is saved, never a reason to train again, never a number that a
record cannot hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.compute import parallel
from framework.compute.rng import stream
from framework.metrics import evaluate as metrics
from framework.metrics import lpips, lpips_weights
from framework.metrics.values import Missing
from tests.metrics.forged_weights import whole_archive
from tests.metrics.test_lpips import features, state_dict
from tests.metrics.test_metrics import image, similar, view_of
from tests.record.test_reuse import group, run, small_config


@pytest.fixture()
def network(tmp_path: Path) -> lpips.Lpips:
    torch.save(state_dict("VGG-16", features("VGG-16")), tmp_path / "weights.pth")
    return lpips.load(tmp_path / "weights.pth")


class Broken:
    """A network that returns given values."""

    name = "VGG"

    def __init__(self, value: float) -> None:
        self.value = value

    def distance(self, x: np.ndarray, y: np.ndarray, centred: bool) -> float:
        return self.value


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_distance_that_is_not_finite_is_missing(value: float) -> None:
    truth = image("truth")
    actual = metrics.evaluate_view(view_of(truth), similar(truth), network=Broken(value))  # type: ignore[arg-type]
    assert actual.lpips == Missing("LPIPS gave no finite value")
    assert metrics.mean_of([actual, actual], "lpips") == Missing("LPIPS gave no finite value")


def test_both_conventions_on_any_number_of_threads(network: lpips.Lpips) -> None:
    truth = torch.from_numpy(stream(0, "truth").random((3, 120, 160))).float()
    view, render = view_of(truth), similar(truth)
    x, y = (metrics.quantise(picture) / 255.0 for picture in (render, truth))
    actual, before = set(), (torch.get_num_threads(), parallel.threads())
    for n in (1, 2, 3):
        torch.set_num_threads(n)
        parallel.set_threads(n)
        (measured,), _ = metrics.evaluate(lambda _: render, [view], network, both=True)
        actual.add((measured.lpips, measured.lpips_01))
        assert torch.get_num_threads() == n
    torch.set_num_threads(before[0])
    parallel.set_threads(before[1])
    assert actual == {(network.distance(x, y), network.distance(x, y, centred=False))}
    # fed as they are: what the authors' way makes of images mapped the other way before
    half = network.distance((x + 1) / 2, (y + 1) / 2)
    assert network.distance(x, y, centred=False) == pytest.approx(half, rel=1e-5)


def test_a_complete_run_gets_lpips_once_there_are_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small_config(group("depth", "ground_truth"))
    bare, _ = run(config, tmp_path / "run")
    assert bare.summary["lpips"] == metrics.NO_LPIPS and bare.provenance["lpips"] is None
    lpips_weights.fetch(whole_archive(tmp_path, monkeypatch))
    filled, reused = run(config, tmp_path / "run")
    assert not reused and filled.identity == bare.identity
    assert filled.parameters_sha256 == bare.parameters_sha256
    assert isinstance(filled.summary["lpips"], float) and filled.provenance["lpips"] == "VGG"
    assert run(config, tmp_path / "run") == (filled, True)
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "lost")
    assert run(config, tmp_path / "run") == (filled, True)
    off = {**config, "metrics": {"lpips_weights": "none"}}
    assert run(off, tmp_path / "off")[0].summary["lpips"] == metrics.NO_LPIPS
