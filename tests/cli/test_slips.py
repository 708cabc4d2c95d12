"""Slips of a newcomer: each ends in one line with the correct words."""

from __future__ import annotations

from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.overrides import quoted
from tests.cli.conftest import FakeRuns


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seed=0,1"], "seed: expected one value, got several (0,1); add -m to make a run of each"),
        (
            ["seed=range(3)"],
            "seed: expected one value, got several (range(3)); add -m to make a run of each: ",
        ),
        (["seed=range(3)"], " 'seed=range(3)' -m"),
        (
            ["scene.width=64", "seed=0,1", "study=x"],
            ": python run.py scene.width=64 seed=0,1 study=x -m",
        ),
        (["method=safi,dba"], "method: expected one value, got several (safi,dba); add -m"),
        (["estimate=true"], "estimate: expected a study, whose duration it estimates"),
        (["~reg"], "~reg: expected a choice of reg, got none; write reg=NAME"),
        (["reg="], "available: anchor_dropout, binocular, co_register"),
        (["reg="], "uar, uar_hard, uniform"),
        (["scene.path=photos"], "; for a folder of photos add scene=photos"),
        (["report"], "report: the following arguments are required: DIR; usage: "),
        (["fetch"], "fetch: the following arguments are required: what; usage: "),
        (["study"], "study: the following arguments are required: what"),
        (["study", "status", "foo", "--dir", "none"], "none: expected the submission 'foo', found"),
        (["render", "RUN", "--cameras", "/nope"], "--cameras: expected a cameras.json as 3DGS "),
        (["render", "RUN", "--cameras", "/nope"], ", got '/nope', which is no file; "),
        (["compare", "A"], "compare: the following arguments are required: RUN; usage: "),
        (["view", "."], "nor runs; name one as reports/STUDY/runs/RUN"),
        (["scene.path=my", "photos"], "a value with spaces or special characters"),
        (["view"], "view: the following arguments are required: RUN; usage: "),
        (["export", "RUN", "--format", "foo"], "argument --format: invalid choice: 'foo' "),
        (["search", "--trials", "x"], "argument --trials: invalid int value: 'x'; usage: "),
        (["compare", "A", "B", "--odd"], "unrecognized arguments: --odd; usage: "),
    ],
)
def test_a_slip_is_one_line(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    said = capsys.readouterr().err
    assert message in said and said.startswith("error: ") and said.count("\n") == 1


def test_what_replaces_a_part_of_a_method_is_told(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["method=safi", "reg=uar"]) == 0
    assert capsys.readouterr().err == ("note: reg=uar replaces the reg of method=safi\n")


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("scene.path=my phötos", "scene.path='my phötos'"),
        ("scene.path=a&b", "scene.path='a&b'"),
        ("scene.path=plain/of letters", "scene.path=plain/of letters"),
        ("scene.path='é'", "scene.path='é'"),
        ("scene.path=2024_05_12", "scene.path='2024_05_12'"),  # no number
        ("+depth.path=1e3", "+depth.path='1e3'"),
        ("study=True", "study='True'"),
        ("seed=2024", "seed=2024"),
        ("scene.path=é,b", "scene.path=é,b"),  # a sweep
        ("-m", "-m"),
    ],
)
def test_letters_that_hydra_does_not_know(typed: str, read: str) -> None:
    assert quoted(typed) == read


def test_a_path_may_have_any_letters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "my phötos"
    folder.mkdir()
    assert main(["scene=photos", f"scene.path={folder}", f"hydra.run.dir={tmp_path / 'run'}"]) == 2
    assert f"{folder}: expected photos" in capsys.readouterr().err


@pytest.mark.parametrize("flag", ["-m", "--multirun"])
@pytest.mark.parametrize("place", range(5))
def test_the_flag_of_a_sweep_may_stand_anywhere(flag: str, place: int, runs: FakeRuns) -> None:
    words = ["reg=uar", "seed=0,1", "trainer.steps=5"]
    line = [*words[:place], flag, *words[place:]] if place < 4 else [flag, "--", *words]
    assert main(line) == 0
    assert [c["seed"] for c in runs.seen] == [0, 1]
