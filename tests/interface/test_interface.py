"""The Python interface does what the command line does."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import fishersplat as fs

SMALL = ("scene.width=96", "scene.height=72", "trainer.steps=6", "trainer.evaluations=1")
COMMITTED = Path(__file__).parents[2] / "reports" / "committed"
QUIET = ("metrics.lpips_weights=none", "study=interface")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> fs.Run:
    return fs.run(*SMALL, *QUIET, folder=tmp_path_factory.mktemp("run"), quiet=True)


def test_a_run_is_read_as_it_was_written(run: fs.Run) -> None:
    again = fs.load_run(run.folder)
    assert again.record == run.record
    assert len(run.metrics) == len(run.record.scene.test) > 0
    assert run.metrics["psnr"].mean() == pytest.approx(run.record.summary["psnr"])
    assert len(run.gaussians) == run.record.gaussians
    assert set(run.cameras) == {*run.record.scene.training, *run.record.scene.test}


def test_a_complete_run_is_not_repeated(run: fs.Run) -> None:
    before = (run.folder / "record.json").stat().st_mtime_ns
    fs.run(*SMALL, *QUIET, folder=run.folder, quiet=True)
    assert (run.folder / "record.json").stat().st_mtime_ns == before


def test_training_in_memory_gives_the_bits_of_a_run(run: fs.Run) -> None:
    scene = fs.load_scene("embedded", width=96, height=72)
    model = fs.train(scene, "trainer.steps=6", "trainer.evaluations=1")
    assert torch.equal(model.gaussians.means, run.gaussians.means)
    assert list(model.history["step"]) == list(run.history["step"])
    camera = scene.test[0].camera
    torch.testing.assert_close(fs.render(model, camera).rgb, fs.render(run, camera).rgb)


def test_the_default_folder_is_that_of_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run = fs.run(*SMALL, *QUIET, "reg=uar_hard", quiet=True)
    assert run.folder.parts[:3] == ("reports", "interface", "runs")
    assert run.folder.name.startswith("none-uar_hard-s0-")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("augment=sofi",), "did you mean 'safi'"),
        (("trainer.steps=many",), "trainer.steps: expected an integer"),
        (("seed=0,1",), "seed: expected one value"),
        (("-m",), "got the flag '-m'"),
    ],
)
def test_invalid_options_are_one_line(options: tuple[str, ...], message: str) -> None:
    with pytest.raises(fs.UserError, match=message) as error:
        fs.run(*options)
    assert "\n" not in str(error.value)


def test_a_folder_without_a_run_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(fs.UserError):
        fs.load_run(tmp_path)


def test_a_committed_study_is_compared_as_its_report_does() -> None:
    study = fs.load_study(COMMITTED / "best_methods5")
    assert len(study.runs) == 150
    assert set(study.runs["method"]) == {"Baseline", "DropGaussian", "SAFI + UAR"}
    rows = study.comparisons().set_index("method")
    assert rows.loc["SAFI + UAR", "difference"] == pytest.approx(-0.03, abs=0.005)
    assert rows.loc["SAFI + UAR", "low"] < rows.loc["SAFI + UAR", "high"] < 0
    assert rows["significant"].all() and (rows["n"] == 5).all()
    other = study.comparisons("dropgaussian").set_index("method")
    assert other.loc["Baseline", "difference"] > 0
    with pytest.raises(fs.UserError, match="expected a method of the report"):
        study.comparisons("something")
