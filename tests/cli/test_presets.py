"""Presets and methods: bundles of choices and options that compose with everything else."""

from __future__ import annotations

import re
from typing import Any

import pytest
import yaml

from framework import registry
from framework.command.cli import main
from framework.command.config.check import check
from framework.command.config.schema import CONF_DIR, ROOT
from framework.options import TrainerOptions
from framework.scenes import LOADERS
from framework.toolbox.dropout import DropoutRegularizer
from framework.toolbox.warping import WarpingAugmenter
from framework.train import schedule
from tests.cli.conftest import FakeRuns
from tests.cli.test_config import composed

PAIRS = {
    "baseline": ("none", "none"),
    "uniform": ("none", "uniform"),
    "dropgaussian": ("none", "dropgaussian"),
    "dba": ("dba", "none"),
    "euclidean": ("euclidean", "none"),
    "full_set": ("full_set", "none"),
    "safi": ("safi", "none"),
    "uar_hard": ("none", "uar_hard"),
    "uar": ("none", "uar"),
    "safi_uar": ("safi", "uar"),
}
PLUGINS = {"dropgaussian": "uniform", "uar_hard": "uar"}  # of the variants


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


@pytest.mark.parametrize(("experiment", "share"), [("coarse_first", 1), ("few_first", 0.5)])
def test_what_comes_late_in_a_coarse_first_training_comes_together(
    experiment: str, share: float
) -> None:
    """Large images and new Gaussians; of the method's dose nothing changes. share: of the first
    Gaussians."""
    words = ("preset=paper", "method=safi_uar")
    config, plain = composed(*words, f"experiment={experiment}"), composed(*words)
    check(config)
    options = TrainerOptions(**config["trainer"])
    late = round(config["capacity"]["start"] * options.steps)
    assert [schedule.coarse_factor(options, step) for step in (0, late - 1, late)] == [2, 2, 1]
    assert config["capacity"]["start"] + 0.15 < config["capacity"]["stop"]
    plain["init"]["per_pixel"] *= share
    assert [config[group] for group in ("augment", "reg", "init")] == [
        plain[group] for group in ("augment", "reg", "init")
    ]


@pytest.mark.parametrize(("name", "pair"), PAIRS.items())
def test_a_method_is_a_pair(name: str, pair: tuple[str, str]) -> None:
    config = composed(f"method={name}")
    augment, reg = pair
    assert (config["augment"]["name"], config["reg"]["name"]) == (augment, PLUGINS.get(reg, reg))
    check(config)


def test_a_choice_on_the_line_beats_the_method(runs: FakeRuns) -> None:
    assert main(["method=safi_uar", "reg=none"]) == 0
    assert runs.methods == [("safi", "none", 0)]


@pytest.mark.parametrize("name", [n for n, pair in PAIRS.items() if n != "baseline"])
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


def test_what_recipes_have_of_their_own_on_a_data_set() -> None:
    """Each file is of a method and a scene that exist, changes what it composes to, and gives way
    to the command line."""
    files = sorted((CONF_DIR / "for_scene").glob("*.yaml"))
    assert files
    for file in files:
        method, _, scene = file.stem.rpartition("_")
        assert (CONF_DIR / "method" / f"{method}.yaml").is_file() and scene in LOADERS, file.name
        elsewhere, there = (
            composed("preset=paper", f"method={method}", f"scene={name}", "scene.path=DIR")
            for name in ("llff", scene)
        )
        parts = [part for part in ("capacity", "reg", "trainer") if there[part] != elsewhere[part]]
        assert parts, f"{file.name} changes nothing"
    line = ("method=corgs", "scene=dtu", "scene.path=DIR", "reg.start=0.3")
    assert composed(*line)["reg"]["start"] == 0.3


ELSEWHERE = {"name", "weight", "seconds", "visits", "evaluations"}
SHARED = {"start", "stop", "every", "form", "regulariser", "tolerance"}  # of several groups
ELSEWHERE |= {"corruption", "strength", "corruption_seed"}


@pytest.mark.parametrize(
    "method", ["baseline", "uniform", "dropgaussian", "uar_hard", "dba", "full_set", "safi_uar"]
)
def test_the_page_of_the_paper_names_every_option_that_acts(method: str) -> None:
    """All but the length of a training, the metrics and the corruption of depth;
    weights act on pseudo views alone, which the page has."""
    page = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
    for word in ("augment.weight=1", "augment.every=1", "augment.roll=false", "reg.p=0.2"):
        assert f"`{word}`" in page
    for word in ("trainer.pseudo_steps=own", "trainer.pseudo_mean=covered"):
        assert f"`{word}`" in page
    config = composed("preset=paper", f"method={method}")
    reference = ("trainer", "init", "depth", "augment", "reg", "capacity")
    groups = [group for group in reference if config[group].get("name") != "none"]
    for group, option in ((g, o) for g in groups for o in config[g].keys() - ELSEWHERE):
        of_one = sum(option in config[other] for other in groups) == 1 and option not in SHARED
        place = rf"({group}\.)?" if of_one else rf"{group}\."
        assert re.search(rf"`{place}{option}(=[^`]*)?`", page), f"{group}.{option}"
        message = re.search(rf"\| [^|]*`{group}\.{option}=([^`]*)`", page)  # of a table
        assert message is None or yaml.safe_load(message[1]) == config[group][option]


RECIPES = sorted(
    path.stem for path in (CONF_DIR / "method").glob("*.yaml") if path.stem not in PAIRS
)
OF_PAPERS = [name for name in RECIPES if not name.endswith("_here")]


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_is_a_configuration_that_can_start(name: str) -> None:
    config = composed(f"method={name}", *(["preset=paper"] if name in OF_PAPERS else []))
    if config["depth"]["name"] == "file":
        config["depth"]["path"] = "DIR"
    check(config)
    if name in OF_PAPERS:
        assert config["trainer"]["lr_scale"] == 1.0 and config["trainer"]["steps"] >= 6000
    else:  # an idea alone
        assert config["trainer"]["steps"] == composed()["trainer"]["steps"]
        assert "evidence" in str(config["capacity"]["name"])
