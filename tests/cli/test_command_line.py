"""What may be typed, and which runs and folders come of it."""

import json
from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.config.schema import SWEEPS_DIR
from framework.errors import UserError
from tests.cli.conftest import FakeRuns, last_values

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


@pytest.mark.parametrize(
    ("line", "study"),
    [
        ("scene=llff scene.path=photos/llff_fern scene.n_views=3", "llff_fern_3v"),
        ("+scene=colmap scene.path=photos/door scene.n_views=12", "colmap_door_12v"),
        (
            "scene=llff scene.path=photos/fern scene.n_views=all scene.split=none",
            "llff_fern_allv_untested",
        ),
        (
            "scene=llff scene.path=photos/fern scene.n_views=3 scene.split=llff_drawn7",
            "llff_fern_3v_drawn",
        ),
        (
            "scene=llff scene.path=photos/fern scene.n_views=3 scene.split=none_drawn7",
            "llff_fern_3v_untested",
        ),
        ("study=mine/first", "mine/first"),
    ],
)
def test_the_study_is_named_after_the_scene(runs: FakeRuns, line: str, study: str) -> None:
    for name in ("photos/llff_fern", "photos/fern", "photos/door"):
        Path(name).mkdir(parents=True)
    assert main(line.split()) == 0
    assert runs.folders[0].parent == Path("reports", study, "runs")
    assert runs.seen[0]["study"] == study


@pytest.mark.parametrize("path", sorted(SWEEPS_DIR.glob("*.yaml")), ids=lambda path: path.stem)
def test_every_sweep_starts(runs: FakeRuns, path: Path) -> None:
    """With the last value of all its axes: the whole cross takes minutes."""
    ends = last_values(path) | {"seed": "7"}
    words = [f"{key}={value}" for key, value in ends.items()]
    words += ["scene=llff", "scene.path=."] if "scene.split" in ends else []
    assert main([f"sweep={path.stem}", *words]) == 0
    assert [seed for _, _, seed in runs.methods] == [7]


def test_the_same_run_twice_is_refused(runs: FakeRuns, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["seed=0,1,0", "-m"]) == 2
    message = capsys.readouterr().err
    assert "for both 'seed=0' and 'seed=0'; sweep each value once" in message and not runs.seen


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
    assert again == "    fishersplat seed=1 -m"
    assert "report: reports/embedded/report.md" in message.out
    record = json.loads((folder / "record.json").read_text(encoding="utf-8"))
    assert (record["status"], record["error"]) == ("failed", reason)
    runs.failures.clear()
    assert main(again.split()[1:]) == 0 and runs.folders[-1] == folder


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
        "error: interrupted; results are kept, continue with: fishersplat seed=0,1,2 -m"
    ]


def test_a_report_that_fails_is_an_error(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["study=unreportable"]) == 2
    assert "report of reports/unreportable: nothing" in capsys.readouterr().err


def test_a_lone_mistake_leaves_no_record(runs: FakeRuns) -> None:
    runs.failures[0] = UserError("scene: no such folder")
    assert main([]) == 2
    assert not (runs.folders[0] / "record.json").exists()
