"""Several regularizers, or capacities, in one run: `reg=[uar,uniform]`."""

from __future__ import annotations

import pytest

from framework import registry
from framework.command.cli import main
from framework.command.config.check import check
from framework.errors import UserError
from framework.train.resume.training_state import Plugins
from tests.cli.conftest import FakeRuns
from tests.cli.test_config import composed


def test_each_has_its_options_and_what_presets_set_of_it() -> None:
    config = composed("reg=uar_hard+uniform", "reg.uniform.p=0.3", "preset=paper")
    check(config)
    reg = config["reg"]
    assert reg["name"] == "uar_hard+uniform" and set(reg) == {"name", "uar_hard", "uniform"}
    assert (reg["uar_hard"]["name"], reg["uar_hard"]["mode"]) == ("uar", "hard")
    assert reg["uniform"]["p"] == 0.3 and reg["uniform"]["start"] == 0.0  # not the default 0.1
    assert list(registry.build_all("reg", reg)) == ["reg.uar_hard", "reg.uniform"]
    assert list(registry.build_all("reg", {"name": "uar"})) == ["reg"]


def test_a_warm_up_lets_each_act_throughout() -> None:
    """What a user lets act late would load its kernels in the timed training."""
    always = Plugins.of(composed("reg=uar+uniform", "reg.uniform.start=0.7")).always()
    assert [(one.start, one.stop) for one in always.group("reg").values()] == [(0, 1), (0, 1)]


def test_a_list_is_a_choice_that_names_the_folder(runs: FakeRuns) -> None:
    line = "-m reg=none,[uar,uniform] seed=0 capacity=[adc,budget]"
    assert main(line.split()) == 0
    assert [c["reg"]["name"] for c in runs.seen] == ["none", "uar+uniform"]
    assert {c["capacity"]["name"] for c in runs.seen} == {"adc+budget"}
    assert [f.name.rpartition("-")[0] for f in runs.folders] == [
        "none-none-s0",
        "none-uar_uniform-s0",
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("reg=[uar,uar]", "error: reg=[uar,uar]: expected different names, got 'uar', 'uar'; "),
        ("reg=[uar,nosuch]", "error: reg=nosuch: unknown reg; available: "),
        ("augment=[safi,dba]", "error: augment=[safi,dba]: expected one augment, got 2; a run may"),
        ("augment=safi+dba", "error: augment=safi+dba: unknown augment; "),
        ("reg=[uar,uniform] reg.uar.q=3", "error: reg.uar.q: unknown option of reg=uar; "),
        (
            "reg=[uar,uniform] reg.p=0.3",
            "error: reg.p: unknown option of reg; did you mean 'reg.uar",
        ),
        ("reg=[uar_hard,uniform] reg.mode=hard", "error: reg.mode: unknown option of reg; did you"),
        ("capacity=[adc_paper,co_prune] capacity.every=3", "error: capacity.every: unknown option"),
        (
            "capacity=[adc_paper,co_prune] +capacity.every=3",
            "error: capacity.every: unknown option",
        ),
        ("reg=[uar_hard,uniform] +reg.no=1", "error: reg.no: unknown option of reg=uar_hard+unif"),
        (
            "reg=[uar,uniform] +reg.p=0.3",
            "error: reg.p: unknown option of reg=uar+uniform; did you",
        ),
        (
            "reg=[uar,uniform] reg.no=0.3",
            "error: reg.no: unknown option of reg; with several plugins",
        ),
        (
            "method=coadapt_sweep reg.p=0.3",
            "error: reg.p: unknown option of reg; with several plugins",
        ),
        ("reg=[uar,]", "error: reg=[uar,]: expected different names, got 'uar', ''"),
    ],
)
def test_what_cannot_be_joined_is_told(
    line: str, message: str, runs: FakeRuns, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith(message) and error.count("\n") == 1 and not runs.seen


def test_a_part_without_options_is_told() -> None:
    config = composed("reg=uar+uniform")
    del config["reg"]["uniform"]
    with pytest.raises(UserError, match=r"^reg\.uniform: expected a choice, got none"):
        check(config)


def test_the_help_tells_the_options_of_each(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help", "reg=[uar_hard,uniform]"]) == 0
    message = capsys.readouterr().out
    assert "  uar_hard:\n    name: uar\n" in message and "    count: bernoulli        # " in message
