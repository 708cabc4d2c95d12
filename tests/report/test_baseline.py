"""The commands that add the baseline to a study."""

import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from framework.report.study.baseline import baseline_commands
from framework.report.study.methods import PLAIN, Method
from framework.report.study.study import Study

UAR = Method("none", "uar")
PLACE = Path("/home/me/reports/a/b/runs/one")


def study_of(*runs: tuple[Method, int, str], place: Path = PLACE) -> Study:
    """A study of runs with a method, a seed and a command line."""
    records = [
        SimpleNamespace(
            method=method,
            seed=seed,
            scene=line,
            run=SimpleNamespace(run_dir=place),
            record=SimpleNamespace(overrides=(f"reg={method.reg}", *line.split(), "study=a/b")),
        )
        for method, seed, line in runs
    ]
    return cast(Any, SimpleNamespace(runs=records, archived=False))


def test_one_command_if_one_sweep_does_all() -> None:
    lines = ["scene=llff scene.path=x", "scene=llff scene.path=y"]
    study = study_of(*((UAR, seed, line) for line in lines for seed in (0, 1)))
    expected = "method=baseline scene=llff scene.path=x,y seed=0,1 study=a/b -m"
    assert baseline_commands(study) == [f"fishersplat {expected}"]


def test_else_one_for_each_command_line() -> None:
    lines = ["scene=llff scene.path=x", "scene=dtu scene.path=y"]
    commands = baseline_commands(study_of(*((UAR, 3, line) for line in lines)))
    assert [shlex.split(c)[2:4] for c in commands] == [line.split() for line in lines]


def test_only_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FISHERSPLAT_PLUGINS", "/my plugins")
    study = study_of((PLAIN, 0, "x=1"), (UAR, 0, "x=1"), (UAR, 0, "x=2"))
    (command,) = baseline_commands(study)
    assert command.endswith(" x=2 seed=0 study=a/b -m --plugins '/my plugins'")
    assert baseline_commands(study_of((PLAIN, 0, "x=1"), (UAR, 0, "x=1"))) == []


def test_a_study_in_another_folder_is_named_by_it(tmp_path: Path) -> None:
    (command,) = baseline_commands(study_of((UAR, 0, "x=1"), place=tmp_path / "a/b/runs/one"))
    assert "study=a/b hydra.sweep.dir=" in command and str(tmp_path.name) in command
    alone = study_of((UAR, 0, "x=1"), place=tmp_path / "one")
    assert baseline_commands(alone) == []
