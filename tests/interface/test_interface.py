"""The Python interface does what the command line does."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import fishersplat as fs
from framework.types import DepthMap
from tests.scenes.synthetic import write_scene

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
        (("estimate=only",), "estimate: expected false"),
    ],
)
def test_invalid_options_are_one_line(options: tuple[str, ...], message: str) -> None:
    with pytest.raises(fs.UserError, match=message) as error:
        fs.run(*options)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "options",
    [("reg=uar,none",), ("seed=range(3)",), ("preset=[fast,best]",), ("reg=uar", "reg=none")],
)
def test_several_runs_are_several_calls(options: tuple[str, ...]) -> None:
    with pytest.raises(fs.UserError, match=r"call run\(\.\.\.\) once for each$") as error:
        fs.run(*options)
    assert "-m" not in str(error.value)


WRONG: dict[str, tuple[Callable[[fs.Run], object], str]] = {
    "list": (lambda run: fs.run(["reg=uar"]), "run: .* got .'reg=uar'. .list.; .*run.*options"),
    "no folder": (lambda run: fs.load_run(None), "load_run: expected a folder, got None; give one"),
    "no study": (lambda run: fs.load_study(3), "load_study: expected a folder, got 3 .int.; give"),
    "target": (lambda run: fs.run(folder=3), "run: expected a folder, got 3 .int.; give"),
    "name": (lambda run: fs.render(run, "test01"), "render: expected a camera, got 'test01' .str."),
    "folder": (
        lambda run: fs.render("reports/x", run.cameras["test00"]),
        "render: expected a Run or a Model, got 'reports/x' .str.; use load_run",
    ),
    "views": (lambda run: fs.load_scene("embedded", n_views="3"), "an integer >= 1, got '3'; set"),
    "words": (
        lambda run: fs.train(fs.load_scene("embedded", width=96, height=72), ["reg=uar"]),
        "train: expected options as texts",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_arguments_of_another_kind_are_one_line(run: fs.Run, case: str) -> None:
    call, message = WRONG[case]
    with pytest.raises(fs.UserError, match=message) as error:
        call(run)
    assert "\n" not in str(error.value)


def test_a_path_is_the_text_of_it(tmp_path: Path) -> None:
    write_scene(tmp_path)
    path: Any = tmp_path
    scenes = [fs.load_scene("colmap", path=one, n_views=3) for one in (path, str(path))]
    assert scenes[0].fingerprint == scenes[1].fingerprint


def test_a_folder_without_a_run_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(fs.UserError, match=r"record\.json") as error:
        fs.load_run(tmp_path)
    assert "\n" not in str(error.value)


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


@pytest.mark.parametrize(
    "word", ["scene.width=96", "+scene=llff", "metrics.lpips_both=true", "study=a"]
)
def test_options_without_effect_on_a_training_are_refused(word: str) -> None:
    scene = fs.load_scene("embedded", width=96, height=72)
    with pytest.raises(fs.UserError, match="got one without effect"):
        fs.train(scene, word)


def test_given_depth_is_checked_and_replaces_the_option() -> None:
    scene = fs.load_scene("embedded", width=96, height=72)
    views = scene.training.views
    maps = [DepthMap(v.depth, (v.depth > 0).float()) for v in views if v.depth is not None]
    short = ("trainer.steps=6", "trainer.evaluations=1")
    given, chosen = (
        fs.train(scene, *short, depth=maps),
        fs.train(scene, *short, "depth=ground_truth"),
    )
    assert torch.equal(given.gaussians.means, chosen.gaussians.means)
    with pytest.raises(fs.UserError, match=f"a map for each of {len(views)} training views, got 1"):
        fs.train(scene, *short, depth=maps[:1])
    with pytest.raises(fs.UserError, match="got one without effect"):
        fs.train(scene, "depth=ground_truth", depth=maps)


def test_a_time_limit_chooses_the_steps() -> None:
    scene = fs.load_scene("embedded", width=96, height=72)
    model = fs.train(scene, "trainer.seconds=0.3", "trainer.members=1", "trainer.steps=100000")
    assert 1 <= model.history["step"].iloc[-1] < 100000


def test_wrong_poses_are_a_warning_when_a_scene_is_loaded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    source = Path(__file__).parents[3] / "shared" / "data" / "open" / "llff_fern"
    if not source.is_dir():
        pytest.skip("no scenes here")
    folder = tmp_path / "fern"
    shutil.copytree(source / "images_8", folder / "images_8")
    poses = np.load(source / "poses_bounds.npy")
    np.save(folder / "poses_bounds.npy", poses[::-1])  # of other photos
    fs.load_scene("llff", path=str(folder), n_views=3, downscale=8)
    assert "scene=llff: " in caplog.text
