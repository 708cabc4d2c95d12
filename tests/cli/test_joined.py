"""Several regularizers, or capacities, in one run: `reg=[uar,uniform]`."""

from framework import registry
from framework.command.cli import main
from framework.command.config.check import check
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
