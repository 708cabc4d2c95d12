"""Words of a newcomer: odd letters in paths, flags anywhere, what replaces a part of a method."""

from pathlib import Path

import pytest

from framework.command.cli import main
from framework.command.overrides import quoted
from tests.cli.conftest import FakeRuns
from tests.record.fakes import fake_run


def test_what_replaces_a_part_of_a_method_is_told(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["method=safi", "reg=uar"]) == 0
    assert capsys.readouterr().err == ("note: reg=uar replaces the reg of method=safi\n")


@pytest.mark.parametrize(
    ("typed", "read"),
    [
        ("scene.path=my phötos", "scene.path='my phötos'"),
        ("scene.path=2024_05_12", "scene.path='2024_05_12'"),  # no number
        ("seed=2024", "seed=2024"),
        ("scene.path=é,b", "scene.path=é,b"),  # a sweep
        ("-m", "-m"),
    ],
)
def test_letters_that_hydra_does_not_know(typed: str, read: str) -> None:
    assert quoted(typed) == read


@pytest.mark.parametrize("line", ["hydra.run.dir={}", "-m hydra.sweep.dir={} hydra.sweep.subdir=."])
def test_the_folder_of_another_run(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    folder = fake_run(Path.cwd(), reg="uar")
    before = sorted(folder.rglob("*"))
    words = line.format(folder).split()
    assert main(words) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"error: {folder}: expected an empty folder or the same run")
    assert "reg=uar" in said and sorted(folder.rglob("*")) == before and not runs.seen
    assert main([*words, "force=true"]) == 0 and len(runs.seen) == 1


@pytest.mark.parametrize(("flag", "place"), [("-m", 0), ("--multirun", 2), ("-m", 4)])
def test_the_flag_of_a_sweep_may_stand_anywhere(flag: str, place: int, runs: FakeRuns) -> None:
    words = ["reg=uar", "seed=0,1", "trainer.steps=5"]
    line = [*words[:place], flag, *words[place:]] if place < 4 else [flag, "--", *words]
    assert main(line) == 0
    assert [c["seed"] for c in runs.seen] == [0, 1]
