"""Hydra's command line: valid uses work, and a study of too many runs is refused
before its runs are listed."""

from __future__ import annotations

import pytest

from framework.command.cli import main
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture

REFUSED = {
    "seed=range(1000000000) -m": "at most 100,000 runs, got 1,000,000,000",
    "seed=range(400) threads=range(400) -m": "at most 100,000 runs, got 160,000",
    "seed=range(0,5,0) -m": "expected a step other than 0",
    "+scene._target_=os.mkdir": "scene._target_: unknown option",
    "+reg.weight._target_=os.mkdir": "reg.weight",
    "hydra/launcher=joblib hydra.launcher.n_jbos=2 seed=0,1 -m": "hydra.launcher.n_jbos",
    "hydra/launcher=joblib hydra.launcher.n_jobs=0 seed=0,1 -m": "n_jobs",
    "hydra/launcher=mine seed=0,1 -m": "hydra/launcher=mine: unknown hydra/launcher",
}


@pytest.mark.parametrize("line", REFUSED)
def test_it_is_refused_in_one_line(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    assert main(line.split()) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert REFUSED[line] in error and not runs.seen


@pytest.mark.parametrize(
    "line",
    [
        "hydra.run.dir=here",
        "hydra.sweep.dir=there seed=0,1 -m",
        "hydra/launcher=basic -m",
        "hydra.verbose=false",
        "seed=range(3) reg=none,uar -m",
        "study=${seed}",
    ],
)
def test_honest_uses_stay(runs: FakeRuns, line: str) -> None:
    assert main(line.split()) == 0
    assert runs.seen


def test_the_joblib_launcher_stays(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("hydra_plugins.hydra_joblib_launcher", reason="no joblib launcher here")
    assert main(["hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "--cfg", "hydra"]) == 0
    assert "n_jobs: 2" in capsys.readouterr().out
