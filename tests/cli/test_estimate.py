"""The time that a study prints before and after its runs."""

import re
from typing import Any

import pytest

from framework.command.cli import main
from framework.command.studies.estimate import Cost, estimate
from tests.cli.conftest import FakeRuns


def config(reg: str = "none", views: int = 3, steps: int = 100, seed: int = 0) -> dict[str, Any]:
    return {
        "seed": seed,
        "scene": {"n_views": views},
        "depth": {},
        "reg": {"name": reg},
        "trainer": {"steps": steps},
    }


def test_a_study_tells_its_time(runs: FakeRuns, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reg=none,uar", "seed=0,1", "trainer.steps=100", "estimate=true", "-m"]) == 0
    message = capsys.readouterr().out
    # 4 runs of 100 x 0.1 s + 2 s; the trials have loaded the scene
    assert "estimate: about 48 s for 4 runs (from 2 trials of" in message
    assert re.search(r"^4 runs took .+ \(estimated 48 s\)$", message, re.MULTILINE)


def test_only_the_estimate_is_printed_and_nothing_trained(
    runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["seed=0,1", "trainer.steps=100", "estimate=only", "-m"]) == 0
    message = capsys.readouterr().out
    assert "estimate: about " in message and " runs took " not in message
    assert main(["seed=0,1", "estimate=maybe", "-m"]) == 2
    assert "estimate: expected true, false or only, got 'maybe'" in capsys.readouterr().err


def test_every_method_and_scene_is_tried() -> None:
    def try_out(c: Any) -> Cost:
        step_s = (2.0 if c["reg"]["name"] == "uar" else 1.0) * c["scene"]["n_views"]
        return Cost(step_s, 10.0, 5.0)

    cross = [config(reg, views) for reg in ("none", "uar") for views in (1, 3)]
    total, trials = estimate(cross, try_out)
    assert trials == 4
    assert total == pytest.approx(100 * (1 + 3 + 2 + 6) + 4 * 10 + 1 * 5)
