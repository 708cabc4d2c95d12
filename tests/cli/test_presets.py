"""Presets and methods: bundles of choices and options that compose with everything else."""

from typing import Any

import pytest

from framework import registry
from framework.command.config.check import check
from framework.command.config.schema import CONF_DIR
from framework.options import TrainerOptions
from framework.toolbox.dropout import DropoutRegularizer
from framework.toolbox.warping import WarpingAugmenter
from framework.train import schedule
from tests.cli.test_config import composed

PAIRS = (  # methods that are an augmenter and a regularizer
    *("uniform", "dropgaussian", "dba", "euclidean", "full_set"),
    *("safi", "uar_hard", "uar", "safi_uar"),
)


def test_the_paper_s_conditions() -> None:
    config = composed("preset=paper")
    check(config)
    options = schedule.paced(TrainerOptions(**config["trainer"]), n_views=43)
    assert (options.steps, options.background, options.sh_degree) == (10_000, "black", 3)
    degrees = [schedule.sh_degree(options, step, 3) for step in (0, 999, 1000, 2000, 3000, 9999)]
    assert degrees == [0, 0, 1, 2, 3, 3]
    first, last = (schedule.learning_rates(options, step, 2.0) for step in (0, 10_000))
    assert first == pytest.approx(
        {
            **{"means": 3.2e-4, "quats": 1e-3, "log_scales": 5e-3},
            **{"opacity_logits": 0.05, "sh0": 2.5e-3, "shN": 2.5e-3 / 20},
        }
    )
    assert last == pytest.approx({**first, "means": 3.2e-6})
    assert (options.opacity_decay, options.coarse_factor, options.pseudo_factor) == (1.0, 1, 1)
    assert options.depth_smoothness == options.binocular == 0 and not options.exposure
    assert config["init"]["completion"] == 0
    assert [config[group]["name"] for group in ("init", "augment", "reg", "capacity")] == [
        *("stereo", "none", "none", "adc")
    ]


def test_the_paper_s_loss_and_its_threshold_are_in_the_same_units() -> None:
    """DropGaussian minimises L1 + 0.2 (1 - SSIM) and densifies from a gradient of 5e-4; we minimise
    that loss divided by 1.2."""
    config = composed("preset=paper")
    w = config["trainer"]["ssim_weight"]
    assert w / (1 - w) == pytest.approx(0.2, rel=1e-6)
    adc = config["capacity"]
    assert adc["grad_threshold"] / (1 - w) == pytest.approx(5e-4, rel=1e-6)
    others = ("every", "from_step", "min_opacity", "reset_every", "reset_opacity", "percent_dense")
    assert [adc[key] for key in others] == [100, 500, 0.005, 3000, 0.01, 0.01]


@pytest.mark.parametrize("name", PAIRS)
def test_the_paper_s_dose_is_every_method_s(name: str) -> None:
    """And of the defaults nothing: they were chosen in this repository."""
    config = composed("preset=paper", f"method={name}")
    check(config)
    augment, reg, trainer = config["augment"], config["reg"], config["trainer"]
    assert (trainer["pseudo_steps"], trainer["pseudo_mean"]) == ("own", "covered")
    if augment["name"] != "none":
        dose: dict[str, Any] = {"every": 1, "roll": False, "weight": 1.0, "start": 0.1, "stop": 1.0}
        assert dose.items() <= augment.items()
    if reg["name"] != "none":
        dose = {"p": 0.2, "schedule": "linear", "start": 0.0, "stop": 1.0}
        assert dose.items() <= reg.items()
        assert reg["compensate"] == (name == "dropgaussian")
    plain = composed(f"method={name}")["trainer"]
    assert (plain["pseudo_steps"], plain["pseudo_mean"]) == ("joined", "frame")


def test_every_warping_augmenter_and_dropout_has_the_paper_s_dose() -> None:
    """A new one needs its file, or `preset=paper` would leave it at the defaults."""
    for group, base in (("augment", WarpingAugmenter), ("reg", DropoutRegularizer)):
        of_family = {n for n, cls in registry.table(group).items() if issubclass(cls, base)}
        files = {path.stem for path in (CONF_DIR / "for_preset" / group).glob("paper_*.yaml")}
        assert {f"paper_{name}" for name in of_family} <= files
    line = ("preset=paper", "augment=safi", "augment.weight=0.5", "augment.every=3")
    changed = composed(*line)["augment"]
    assert (changed["weight"], changed["every"], changed["roll"]) == (0.5, 3, False)


RECIPES = sorted(
    {path.stem for path in (CONF_DIR / "method").glob("*.yaml")} - {"baseline", *PAIRS}
)
OF_PAPERS = [name for name in RECIPES if not name.endswith("_here")]


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_is_a_configuration_that_can_start(name: str) -> None:
    config = composed(f"method={name}", *(["preset=paper"] if name in OF_PAPERS else []))
    if config["depth"]["name"] == "file":  # a recipe of a network's depth
        config["depth"]["path"] = "DIR"
    check(config)
    if name in OF_PAPERS:
        assert config["trainer"]["lr_scale"] == 1.0 and config["trainer"]["steps"] >= 6000
    else:  # an idea alone
        assert config["trainer"]["steps"] == composed()["trainer"]["steps"]
        assert "evidence" in str(config["capacity"]["name"])
