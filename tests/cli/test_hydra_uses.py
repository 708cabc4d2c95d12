"""Hydra's command line: valid uses work."""

import pytest

from framework.command.cli import main
from tests.cli.conftest import FakeRuns, runs

__all__ = ["runs"]  # the fixture


@pytest.mark.parametrize(
    "line",
    [
        "hydra.sweep.dir=there seed=0,1 -m",
        "hydra/launcher=basic -m",
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
