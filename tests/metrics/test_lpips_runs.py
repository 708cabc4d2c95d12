"""LPIPS in runs: measured from what is saved, never a reason to train again, never a number that a
record cannot hold."""

from pathlib import Path

import numpy as np
import pytest
import torch

from framework.compute import parallel
from framework.compute.rng import stream
from framework.errors import UserError
from framework.metrics import evaluate as metrics
from framework.metrics import lpips, lpips_weights
from framework.metrics.values import METRICS, NOT_REQUESTED, Missing
from framework.records.record import read_run
from framework.run.lpips_later import with_lpips
from tests.metrics.forged_weights import whole_archive
from tests.metrics.test_lpips import features, state_dict
from tests.metrics.test_metrics import image, similar, view_of
from tests.record.fakes import fake_run, measured
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
    actual = measured(view_of(truth), similar(truth), Broken(value))
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
        (both,), _ = metrics.evaluate(lambda _: render, [view], network, both=True)
        actual.add((both.lpips, both.lpips_01))
        assert torch.get_num_threads() == n
    torch.set_num_threads(before[0])
    parallel.set_threads(before[1])
    assert actual == {(network.distance(x, y), network.distance(x, y, centred=False))}
    # fed as they are: what the authors' way makes of images mapped the other way before
    half = network.distance((x + 1) / 2, (y + 1) / 2)
    assert network.distance(x, y, centred=False) == pytest.approx(half, rel=1e-5)


def test_the_second_convention_is_measured_on_request(network: lpips.Lpips) -> None:
    truth = image("truth")
    actual = measured(view_of(truth), similar(truth), network)
    assert isinstance(actual.lpips, float) and actual.lpips_01 == NOT_REQUESTED


def test_progress_of_lpips_is_reported(
    network: lpips.Lpips, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "REPORT_S", 0.0)
    truth, lines = image("truth"), list[str]()
    views = [view_of(truth)] * 3
    metrics.evaluate(lambda _: similar(truth), views, network, report=lines.append)
    assert [line[-10:] for line in lines] == ["1/3 images", "2/3 images", "3/3 images"]


def test_a_complete_run_gets_lpips_once_there_are_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = small_config(group("depth", "ground_truth"))
    bare, _ = run(config, tmp_path / "run")
    assert bare.summary["lpips"] == metrics.NO_LPIPS and bare.provenance["lpips"] is None
    lpips_weights.fetch(whole_archive(tmp_path, monkeypatch))
    filled, reused = run(config, tmp_path / "run")
    fresh, _ = run(config, tmp_path / "fresh")
    assert reused and filled.identity == fresh.identity == bare.identity
    assert filled.summary == fresh.summary and filled.provenance["lpips"] == "VGG"
    assert isinstance(filled.summary["lpips"], float) and filled.timings == bare.timings
    pair = [read_run(tmp_path / name).metrics for name in ("run", "fresh")]
    for metric in METRICS:
        assert np.array_equal(pair[0].numbers[metric], pair[1].numbers[metric], equal_nan=True)
    assert run(config, tmp_path / "run") == (filled, True)
    monkeypatch.setattr(lpips_weights, "cache_dir", lambda: tmp_path / "lost")
    assert run(config, tmp_path / "run") == (filled, True)
    off = {**config, "metrics": {"lpips_weights": "none"}}
    assert run(off, tmp_path / "off")[0].summary["lpips"] == metrics.NO_LPIPS


def test_saved_files_that_do_not_fit(tmp_path: Path, network: lpips.Lpips) -> None:
    run_dir = fake_run(tmp_path, run_name="run")
    actual = read_run(run_dir)
    table, record = (run_dir / "metrics.csv").read_text(), actual.record
    (run_dir / "metrics.csv").write_text(table.replace('lpips""', 'other""'))
    with pytest.raises(UserError, match="expected a reason for every missing metric"):
        with_lpips(run_dir, record, network)
    (run_dir / "metrics.csv").write_text(table)
    stem = actual.metrics.texts["file"][0]
    small = run_dir / "renders" / f"{stem}.png"
    from PIL import Image

    Image.new("RGB", (9, 9)).save(small)
    with pytest.raises(UserError, match="expected an image of the truth's size 64x48, got 9x9"):
        with_lpips(run_dir, record, network)
