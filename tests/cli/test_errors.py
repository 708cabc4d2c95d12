"""Bad input: one line that says where and what, exit code 2, and nothing left behind."""

from pathlib import Path

import pytest

from framework.command.cli import main
from framework.errors import UserError
from tests.cli.conftest import FakeRuns

LONG = "a" * 300
CASES = {
    "augment=sofi": ["augment=sofi: unknown augment", "did you mean 'safi'?", "none, safi"],
    "+reg=uarr": ["reg=uarr: unknown reg", "did you mean 'uar'?", "uar_hard"],
    "sweep=demo method=safi": ["method=safi: expected no method together with augment and reg"],
    "trainer.stepz=3": ["trainer.stepz: unknown option", "did you mean 'steps'?"],
    "reg=uar reg.wieght=3": ["reg.wieght: unknown option of reg=uar", "did you mean 'weight'?"],
    "augment.eta=1.2": [
        "augment.eta: unknown option of augment=none; did you mean 'augment.eta' of augment=euclid",
        "safi? available: start, stop, weight",
    ],
    "steps=5": [
        "steps: unknown option; did you mean 'trainer.steps'? available: augment,",
        "preset",
    ],
    "sweep=first,demo": [
        "sweep: expected one choice, got several (sweep=first,demo); run them one"
    ],
    "seed=1 seed=2": [
        "seed: expected one value, got two words (seed=1 and seed=2); leave one out, or write",
        "write seed=1,2 -m for a run of each",
    ],
    "augment=null": ["augment: expected a choice, got none; write augment=NAME"],
    "trainer.steps=abc": ["trainer.steps: expected an integer, got 'abc'"],
    "trainer.steps=0": ["trainer.steps: expected an integer from 1 to 1,000,000, got 0"],
    "reg.start=0.9 reg.stop=0.1": ["reg=none: expected 0 <= start <= stop <= 1"],
    "seed=0,-1 -m": ["seed: expected an integer >= 0, got -1"],
    "augment=safi augment.weight=inf": ["augment=safi: weight must be a finite number >= 0, got"],
    "study=../elsewhere": ["study: expected a folder name", "'../elsewhere'"],
    "metrics.also=nope": [
        "metrics.also: unknown metric 'nope'; every run measures psnr, ssim, flip, lpips, lpips_01"
    ],
    "scene=llff": ["scene.path: required by scene=llff, got nothing; add scene.path=VALUE"],
    "scene=llff scene.path=x scene.n_views=each": [
        "scene=llff: expected n_views to be an integer >= 1 or all, got 'each'; set scene.n_views"
    ],
    "scene=mip360 scene.path=x scene.split=non": [
        "scene.split=non: unknown protocol; did you mean"
    ],
    "threads=1,2 -m": ["multirun: expected a folder for each run", "study=NAME"],
    "scene=llff scene.path=/nowhere seed=0,1 -m": [
        "scene=llff: expected a file or folder at '/nowhere', found nothing; correct scene.path"
    ],
    "method=baseline,fsgs -m": [
        "depth=depth_anything_3: expected the package depth_anything_3, got none; install it with:",
        "or take the plane sweep instead of a network: method=fsgs_sweep",
    ],
    "--nonsense": ["command line: unrecognized arguments: --nonsense"],
    "--cfg job -m": ["command line: expected -m or a flag that only informs"],
    "seed": ["command line: expected KEY=VALUE or a subcommand, got 'seed'"],
    "trainer.lr_scale=${nowhere}": ["nowhere"],
    "seed=range(0,5,0) -m": ["range() arg 3 must not be zero"],
    "+scene._target_=os.mkdir": ["scene._target_: unknown option"],
    "hydra/launcher=joblib hydra.launcher.n_jbos=2 seed=0,1 -m": ["hydra.launcher.n_jbos"],
    "seed=range(0) -m": ["multirun: seed=range(0) gives no value, so there is no run"],
    "method=[a,b]": ["method: expected one choice, got several (method=[a,b]); write"],
    "~trainer.steps": ["~trainer.steps: an option cannot be removed"],
    "--versio": ["command line: unrecognized arguments: --versio"],
    "study submit": ["study submit: expected the words of a study, got none"],
    "reg=[uar,uar]": ["reg=[uar,uar]: expected different names, got 'uar', 'uar'; "],
    "augment=[safi,dba]": ["augment=[safi,dba]: expected one augment, got 2; a run may"],
    "reg=[uar,uniform] reg.uar.q=3": ["reg.uar.q: unknown option of reg=uar; "],
    "reg=[uar,uniform] reg.p=0.3": ["reg.p: unknown option of reg; with several plugins"],
    "seed=0,1": ["seed: expected one value, got several (0,1); add -m to make a run of each"],
    "scene.width=64 seed=0,1 study=x": [": fishersplat scene.width=64 seed=0,1 study=x -m"],
    "estimate=true": ["estimate: expected a study, whose duration it estimates"],
    "~reg": ["reg: expected a choice, got none; write reg=NAME"],
    "scene.path=photos": ["; for a folder of photos add scene=photos"],
    "report": ["report: the following arguments are required: DIR; usage: "],
    "study status": ["expected a submitted study, found none"],
    "study submit hydra/launcher=ray seed=0,1": ["ray job submit"],
    "study status foo --dir none": ["none: expected the submission 'foo', found"],
    "render RUN --cameras /nope": ["--cameras: expected a cameras.json as 3DGS "],
    "view .": ["nor runs; name one as reports/STUDY/runs/RUN"],
    "scene.path=my photos": ["a value with spaces or special characters"],
    "export RUN --format foo": ["argument --format: invalid choice: 'foo' "],
    "compare A B --odd": ["unrecognized arguments: --odd; usage: "],
    f"seed={'1' * 5000}": ["command line: expected options of the configuration, got"],
    "=3": ["cannot read '=3'; write KEY=VALUE"],
    "experiment=3": ["expected options of the configuration, got what Hydra refuses (Config group"],
    "-m reg.start=interval(0,1)": ["multirun: expected a list of values, such as"],
    "-m seed=range(0,nan)": ["got what Hydra refuses"],
    "scene.path=\udcff scene=colmap": ["command line: expected UTF-8"],
    f"study={LONG}": ["got 'File name too long'; correct the path"],
    f"scene=colmap scene.path={'b' * 4000}": ["got 'File name too long'; correct the path"],
    "hydra.run.dir=/dev/null/x": ["got 'Not a directory'; correct the path"],
}


@pytest.mark.parametrize("line", CASES, ids=range(len(CASES)))
def test_bad_input_is_one_line(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main(line.split()) == 2
    message = capsys.readouterr()
    lines = message.err.splitlines()
    assert len(lines) == 1 and len(lines[0]) < 1010, message.err
    assert lines[0].startswith("error: ")
    for part in CASES[line]:
        assert part in lines[0]
    assert "Traceback" not in message.err
    assert not runs.seen
    assert not list(Path().glob("reports/*"))


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


@pytest.mark.parametrize("links", ["0", "1"])
def test_an_experiment_cannot_half_configure_another_choice(
    runs: FakeRuns,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    links: str,
) -> None:
    monkeypatch.setenv("OC_CAUSE", links)  # 1: causes form a cycle, as under a debugger
    folder = Path("own/experiment")
    folder.mkdir(parents=True)
    text = "# @package _global_\ndefaults:\n  - override /augment: safi\naugment:\n  eta: 1.4\n"
    (folder / "wide.yaml").write_text(text, encoding="utf-8")
    search = f"hydra.searchpath=[file://{folder.parent.resolve()}]"
    assert main([search, "experiment=wide"]) == 0
    assert runs.seen[0]["augment"]["eta"] == 1.4
    assert main([search, "experiment=wide", "augment=none"]) == 2
    assert "augment.eta: unknown option of augment=none" in capsys.readouterr().err
