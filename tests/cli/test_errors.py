"""Bad input: one line that says where and what, exit code 2, and nothing left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.command.cli import main
from framework.errors import UserError
from tests.cli.conftest import FakeRuns

CASES = {
    "augment=sofi": ["augment=sofi: unknown augment", "did you mean 'safi'?", "none, safi"],
    "+reg=uarr": ["reg=uarr: unknown reg", "did you mean 'uar'?", "uar_hard"],
    "reg=none,uarr -m": ["reg=uarr: unknown reg", "did you mean 'uar'?"],
    "scene=lff": ["scene=lff: unknown scene", "did you mean 'llff'?"],
    "depth=planesweep": ["depth=planesweep", "did you mean 'plane_sweep'?"],
    "sweep=demo method=safi": ["method=safi: expected no method together with augment and reg"],
    "sweep=demo method=safi augment=dba": [
        "method=safi: expected no method together with augment and reg"
    ],
    "method=safi,uar augment=dba reg=uar -m": [
        "method=safi,uar: expected no method together with augment and reg"
    ],
    "sweep=dem": ["sweep=dem", "did you mean 'demo'?"],
    "trainer.stepz=3": ["trainer.stepz: unknown option", "did you mean 'steps'?"],
    "+trainer.stepz=3": ["trainer.stepz: unknown option", "did you mean 'steps'?"],
    "+typo=3": ["typo: unknown option", "available: augment"],
    "augmment=safi": ["augmment: unknown option", "did you mean 'augment'?"],
    "reg=uar reg.wieght=3": ["reg.wieght: unknown option of reg=uar", "did you mean 'weight'?"],
    "+reg.wieght=3": ["reg.wieght: unknown option of reg=none"],
    "augment.eta=1.2": [
        "augment.eta: unknown option of augment=none; did you mean 'augment.eta' of augment=euclid",
        "safi? available: start, stop, weight",
    ],
    "steps=5": [
        "steps: unknown option; did you mean 'trainer.steps'? available: augment,",
        "preset",
    ],
    "+n_views=5": ["n_views: unknown option; did you mean 'scene.n_views'? available: augment,"],
    "trainer.n_views=5": ["n_views: unknown option of trainer; did you mean 'scene.n_views'?"],
    "reg=uar reg=uniform": [
        "reg: expected one choice, got two words",
        "reg=[uar,uniform] for both",
    ],
    "+reg=uar,none reg=uniform -m": ["uniform); write reg=uar,none,uniform -m for a run"],
    "preset=fast preset=best": ["got two words (preset=fast and preset=best); write preset=fast,"],
    "sweep=first,demo": ["sweep: expected one study, got several (sweep=first,demo); run them one"],
    "sweep=first,demo -m": ["sweep: expected one study, got several", "each as sweep=NAME"],
    "+sweep=[first,demo]": ["sweep: expected one study, got several (sweep=[first,demo]); run"],
    "sweep=glob(*) -m": ["sweep: expected one study, got several (sweep=glob(*)); run"],
    "sweep=first sweep=demo": ["got two words (sweep=first and sweep=demo); run them one after"],
    "seed=1 seed=2": [
        "seed: expected one value, got two words (seed=1 and seed=2); leave one out, or write",
        "write seed=1,2 -m for a run of each",
    ],
    "trainer.steps=5 +trainer.steps=6": ["got two words (trainer.steps=5 and +trainer.steps=6)"],
    "study=a seed=0,1 study=b -m": ["study: expected one value, got two words", "leave one out"],
    "augment=null": ["augment: expected a choice, got 'null'; available: dba,"],
    "augment=": ["augment: expected a choice, got ''"],
    "trainer.steps=abc": ["trainer.steps: expected an integer, got 'abc'"],
    "trainer.steps=1.5": ["trainer.steps: expected an integer, got 1.5"],
    "force=perhaps": ["force: expected true or false, got 'perhaps'"],
    "reg.weight=heavy": ["reg.weight: expected a number, got 'heavy'"],
    "trainer.steps=0": ["trainer.steps: expected an integer from 1 to 1,000,000, got 0"],
    "trainer.steps=800,0 -m": ["trainer.steps: expected an integer from 1 to 1,000,000, got 0"],
    "reg=uar reg.candidate_factor=70": ["reg.candidate_factor", "got 70"],
    "reg.start=0.9 reg.stop=0.1": ["reg=none: expected 0 <= start <= stop <= 1"],
    "seed=-1": ["seed: expected an integer >= 0, got -1"],
    "seed=0,-1 -m": ["seed: expected an integer >= 0, got -1"],
    "seed=0,x -m": ["seed: expected an integer, got 'x'"],
    "seed=0,1.5 -m": ["seed: expected an integer, got 1.5"],
    "seed=0,null -m": ["seed: expected an integer, got None"],
    "seed=range(2,-2,-1) reg=none,uar -m": ["seed: expected an integer >= 0, got -1"],
    "seed=9223372036854775808": ["seed: expected an integer below 2^63, got 9223372036854775808"],
    "augment=safi augment.weight=inf": ["augment=safi: weight must be a finite number >= 0, got"],
    "threads=-1": ["threads: expected an integer >= 0, got -1"],
    "study=../elsewhere": ["study: expected a folder name", "'../elsewhere'"],
    "study=a//b": ["study: expected a folder name", "or several joined by /, got 'a//b'; rename"],
    "metrics.also=nope": [
        "metrics.also: unknown metric 'nope'; every run measures psnr, ssim, flip, lpips, lpips_01",
    ],
    "hydra/launcher=nope": ["unknown hydra/launcher; available: basic, joblib, ray, submitit_loc"],
    "scene=llff": ["scene.path: required by scene=llff, got nothing; add scene.path=VALUE"],
    "scene=colmap,embedded -m": ["scene.path: required by scene=colmap"],
    "scene=llff scene.path=x scene.n_views=each": [
        "scene=llff: expected n_views to be an integer >= 1 or all, got each; set scene.n_views"
    ],
    "scene=colmap scene.path=. scene.n_views=3,al -m": ["an integer >= 1 or all, got al; set"],
    "scene=dtu scene.path=x scene.n_views=2.5": [
        "scene.n_views: expected an integer or a text, got 2.5"
    ],
    "scene=transforms scene.path=x scene.n_views=null": ["scene.n_views: expected an integer or a"],
    "scene=mip360 scene.path=x scene.split=non": [
        "scene.split=non: unknown protocol; did you mean"
    ],
    "scene.n_views=all": ["scene.n_views: expected an integer, got 'all'"],
    "threads=1,2 -m": ["multirun: expected a folder for each run", "study=NAME"],
    "hydra.sweep.subdir=x seed=0,1 -m": ["expected a folder for each run", "hydra.sweep.subdir"],
    "seed=0,1": ["seed"],
    "scene=llff scene.path=/nowhere seed=0,1 -m": [
        "scene=llff: expected a file or folder at '/nowhere', found nothing; correct scene.path"
    ],
    "depth=file depth.path=/nowhere seed=0,1 -m": [
        "depth=file: expected a file or folder at '/nowhere', found nothing; correct depth.path"
    ],
    "method=baseline,fsgs -m": [
        "depth=depth_anything_3: expected the package depth_anything_3, got none; install it with:",
        "or take the plane sweep instead of a network: method=fsgs_sweep",
    ],
    "--nonsense": ["command line: unrecognized arguments: --nonsense"],
    "--cfg job -m": ["command line: expected -m or a flag that only informs"],
    "--resolve": ["command line: expected --cfg with --resolve"],
    "seed": ["command line: expected KEY=VALUE or a subcommand, got 'seed'"],
    "trainer.lr_scale=${nowhere}": ["nowhere"],
}


@pytest.mark.parametrize("line", CASES)
def test_bad_input_is_one_line(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main(line.split()) == 2
    message = capsys.readouterr()
    lines = message.err.splitlines()
    assert len(lines) == 1, message.err
    assert lines[0].startswith("error: ")
    for part in CASES[line]:
        assert part in lines[0]
    assert "Traceback" not in message.err
    assert not runs.seen
    assert not Path("reports").exists()


def test_a_value_with_spaces_asks_for_quotes(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["scene=llff", "scene.path=my (photos)"]) == 2
    assert "put quotes around" in capsys.readouterr().err


@pytest.mark.parametrize("line", ["trainer.steps=abc", "trainer.steps=0"])
def test_the_traceback_is_there_for_the_asking(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main([line, "traceback=true"]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_the_traceback_of_a_run_is_there_for_the_asking(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.failures[0] = UserError("scene: no images")
    assert main([]) == 2
    assert capsys.readouterr().err == "error: scene: no images\n"
    assert main(["traceback=true"]) == 2
    message = capsys.readouterr().err
    assert "Traceback" in message
    assert message.splitlines()[-1] == "error: scene: no images"


def test_a_file_that_may_not_be_opened_is_bad_input(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.failures[0] = PermissionError(13, "Permission denied", "photo.png")
    assert main([]) == 2
    assert capsys.readouterr().err == (
        "error: photo.png: expected what may be opened, got 'Permission denied'; change its rights"
        " or choose another, and run the same again\n"
    )


def test_an_experiment_cannot_half_configure_another_choice(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = Path("own/experiment")
    folder.mkdir(parents=True)
    text = "# @package _global_\ndefaults:\n  - override /augment: safi\naugment:\n  eta: 1.4\n"
    (folder / "wide.yaml").write_text(text, encoding="utf-8")
    search = f"hydra.searchpath=[file://{folder.parent.resolve()}]"
    assert main([search, "experiment=wide"]) == 0
    assert runs.seen[0]["augment"]["eta"] == 1.4
    assert main([search, "experiment=wide", "augment=none"]) == 2
    assert "augment.eta: unknown option of augment=none" in capsys.readouterr().err
