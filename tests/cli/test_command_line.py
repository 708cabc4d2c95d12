"""What may be typed, and which runs and folders come of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from framework.command.cli import main
from framework.command.config.schema import SWEEPS_DIR
from framework.errors import UserError
from tests.cli.conftest import FakeRuns

TYPED = "+augment=safi +reg=uar seed=0,1,2 -m"
SEEDS = [("safi", "uar", seed) for seed in (0, 1, 2)]


@pytest.mark.parametrize(
    "line",
    [
        TYPED,
        "-m augment=safi reg=uar seed=0,1,2",
        "--multirun seed=range(3) +reg=uar augment=safi",
    ],
)
def test_the_command_as_typed_and_its_variants(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main(line.split()) == 0
    assert runs.methods == SEEDS
    message = capsys.readouterr()
    assert "[run 2 of 3] safi+uar seed 1 · finished" in message.out
    assert message.out.splitlines()[-1] == "report: reports/embedded/report.md"
    assert message.err == ""


def test_progress_lines_say_what_changes_from_run_to_run(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["capacity=fixed,evidence", "trainer.steps=30", "reg=none,uar", "-m"]
    assert main(line) == 0
    message = [text for text in capsys.readouterr().out.splitlines() if "finished" in text]
    assert message[0] == "[run 1 of 4] none+none capacity=fixed seed 0 · finished"
    assert message[3] == "[run 4 of 4] none+uar capacity=evidence seed 0 · finished"


def test_of_a_path_progress_lines_have_the_end(
    runs: FakeRuns, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / "a folder" / name for name in ("fern", "x" * 99)]
    numbers = "trainer.depth_smoothness=0.000125,0.000121"
    for folder in folders:
        folder.mkdir(parents=True)
    paths = ",".join(f"'{folder}'" for folder in folders)
    main(["scene=llff", f"scene.path={paths}", "study=s", "-m"])
    message = capsys.readouterr().out
    assert "none+none scene.path=a folder/fern seed 0 · " in message
    assert f"none+none path=a folder/{'x' * 22}… seed 0 · " in message
    main([numbers, "-m"])
    message = capsys.readouterr().out
    assert "none+none depth_smoothness=0.000125 seed 0 · " in message
    assert "none+none depth_smoothness=0.000121 seed 0 · " in message


def test_spelling_does_not_change_the_folder(runs: FakeRuns) -> None:
    main(TYPED.split())
    main(["-m", "augment=safi", "reg=uar", "seed=0,1,2", "threads=1", "force=true"])
    main(["augment=safi", "reg=uar"])
    assert runs.folders[:3] == runs.folders[3:6]
    assert runs.folders[6] == runs.folders[0]
    assert len(set(runs.folders)) == 3
    for folder in runs.folders:
        assert (folder / ".hydra" / "config.yaml").is_file()
        assert folder.parent == Path("reports/embedded/runs")
        assert folder.name.startswith("safi-uar-s")


def test_the_defaults(runs: FakeRuns, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    config = runs.seen[0]
    names = [config[g]["name"] for g in ("scene", "depth", "init", "augment", "reg", "capacity")]
    assert names == ["embedded", "plane_sweep", "stereo", "none", "none", "evidence"]
    assert (config["seed"], config["threads"], config["study"]) == (0, 0, "embedded")
    assert (config["force"], config["metrics"]) == (
        False,
        {
            **{"lpips_weights": None, "lpips_both": False, "views": 0},
            **{"also": None, "coadaptation": False},
        },
    )
    assert "none+none seed 0 · finished" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("line", "study"),
    [
        ("scene=llff scene.path=photos/llff_fern scene.n_views=3", "llff_fern_3v"),
        ("scene=llff scene.path=photos/fern/ scene.n_views=6", "llff_fern_6v"),
        ("+scene=colmap scene.path=photos/door scene.n_views=12", "colmap_door_12v"),
        ("scene=llff scene.path=photos/fern scene.n_views=all", "llff_fern_allv"),
        (
            "scene=llff scene.path=photos/fern scene.n_views=all scene.split=none",
            "llff_fern_allv_untested",
        ),
        (
            "scene=llff scene.path=photos/fern scene.n_views=3 scene.split=llff_drawn7",
            "llff_fern_3v_drawn",
        ),
        (
            "scene=llff scene.path=photos/fern scene.n_views=3 scene.split=llff_drawn7_held_out",
            "llff_fern_3v_drawn_held_out",
        ),
        (
            "scene=llff scene.path=photos/fern scene.n_views=3 scene.split=none_drawn7",
            "llff_fern_3v_untested",
        ),
        ("scene.n_views=4", "embedded_4v"),
        ("study=mine/first", "mine/first"),
    ],
)
def test_the_study_is_named_after_the_scene(runs: FakeRuns, line: str, study: str) -> None:
    for name in ("photos/llff_fern", "photos/fern", "photos/door"):
        Path(name).mkdir(parents=True)
    assert main(line.split()) == 0
    assert runs.folders[0].parent == Path("reports", study, "runs")
    assert runs.seen[0]["study"] == study


def test_a_folder_given_by_hand_gets_everything(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["hydra.run.dir=here"]) == 0
    assert runs.folders == [Path("here")]
    assert sorted(path.name for path in Path("here").iterdir()) == [".hydra", "report.md"]
    assert not Path("reports").exists()
    assert "report: here/report.md" in capsys.readouterr().out


@pytest.mark.parametrize("end", [0, -1])
@pytest.mark.parametrize("path", sorted(SWEEPS_DIR.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_sweep_starts(runs: FakeRuns, path: Path, end: int) -> None:
    """With the first and with the last value of all its axes: the whole cross takes minutes."""
    params = OmegaConf.load(path).hydra.sweeper.params
    ends = {key: str(values).split(",")[end] for key, values in params.items()} | {"seed": "7"}
    words = [f"{key}={value}" for key, value in ends.items()]
    words += ["scene=llff", "scene.path=."] if "scene.split" in params else []
    assert main([f"sweep={path.stem}", *words]) == 0
    assert [seed for _, _, seed in runs.methods] == [7]


def test_an_option_beside_a_swept_group(runs: FakeRuns) -> None:
    assert main(["reg=uar,uar_hard", "reg.start=0.5", "-m"]) == 0
    assert [(c["reg"]["mode"], c["reg"]["start"]) for c in runs.seen] == [
        ("soft", 0.5),
        ("hard", 0.5),
    ]


def test_a_sweep_over_scenes_reports_each(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("a").mkdir()
    Path("b").mkdir()
    assert main(["scene=llff", "scene.path=a,b", "-m"]) == 0
    reports = [line for line in capsys.readouterr().out.splitlines() if line.startswith("report")]
    assert reports == [f"report: reports/llff_{name}_3v/report.md" for name in "ab"]


def test_the_same_run_twice_is_refused(runs: FakeRuns, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["seed=0,1,0", "-m"]) == 2
    message = capsys.readouterr().err
    assert (
        message
        == "error: multirun: expected each run once, got 'seed=0' twice; sweep each value once\n"
    )
    assert not runs.seen


def test_a_failing_run_is_recorded_and_the_others_go_on(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.failures[1] = UserError("depth: expected two views, got one; add a view")
    assert main(["seed=0,1,2", "-m"]) == 2
    assert [method[2] for method in runs.methods] == [0, 1, 2]
    message = capsys.readouterr()
    folder = runs.folders[1]
    reason = "depth: expected two views, got one; add a view"
    first, head, row, again = message.err.splitlines()
    assert first.startswith("error: 1 of 3 runs failed; the same command repeats them")
    assert head.split() == ["run", "kind", "reason"]
    assert row == f"  {folder}  bad input  {reason}"
    assert again == "    python run.py seed=1 -m"
    assert "report: reports/embedded/report.md" in message.out
    record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    assert (record["status"], record["error"]) == ("failed", reason)
    runs.failures.clear()
    assert main(again.split()[2:]) == 0 and runs.folders[-1] == folder


def test_a_bug_shows_its_traceback_and_exits_with_1(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    runs.failures[0] = RuntimeError("unlucky")
    assert main([]) == 1
    message = capsys.readouterr()
    assert "Traceback" in message.err
    assert message.err.splitlines()[-1] == "error: RuntimeError: unlucky"
    assert "report:" not in message.out


def test_an_interrupt_is_one_line(runs: FakeRuns, capsys: pytest.CaptureFixture[str]) -> None:
    runs.failures[1] = KeyboardInterrupt()
    assert main(["seed=0,1,2", "-m"]) == 130
    assert len(runs.seen) == 2
    assert capsys.readouterr().err.splitlines() == [
        "error: interrupted; results are kept, continue with: python run.py seed=0,1,2 -m"
    ]


def test_a_report_that_fails_is_an_error(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study=unreportable"]) == 2
    assert "report of reports/unreportable: UserError: nothing" in capsys.readouterr().err


def test_nothing_of_a_command_stays_in_the_process(runs: FakeRuns) -> None:
    import os
    import sys

    before = dict(os.environ), list(sys.argv)
    main(["seed=0,1", "-m"])
    assert (dict(os.environ), list(sys.argv)) == before


def test_a_failure_keeps_an_earlier_complete_record(runs: FakeRuns) -> None:
    runs.failures[0] = UserError("scene: the photos are gone")
    assert main(["seed=0", "-m"]) == 2
    path = runs.folders[0] / "record.json"
    complete = path.read_text(encoding="utf-8").replace('"failed"', '"complete"')
    path.write_text(complete, encoding="utf-8")
    assert main(["seed=0", "-m"]) == 2
    assert path.read_text(encoding="utf-8") == complete
    path.write_text("damaged", encoding="utf-8")
    assert main(["seed=0", "-m"]) == 2
    assert json.loads(path.read_text(encoding="utf-8"))["status"] == "failed"


def test_a_lone_mistake_leaves_no_record(runs: FakeRuns) -> None:
    runs.failures[0] = UserError("scene: no such folder")
    assert main([]) == 2
    assert not (runs.folders[0] / "record.json").exists()
