"""Methods and scenes as values: what differs is named, what cannot matter is not."""

from collections.abc import Sequence
from typing import Any

import pytest

from framework.records.record import SceneInfo
from framework.registry import GROUPS, table
from framework.report.study.methods import (
    PLAIN,
    Method,
    by_recipe,
    methods_of,
    name_methods,
    recipe_of,
)
from framework.report.study.plugins import papers
from framework.report.study.published import bibtex, literature
from framework.report.study.scenes import scene_labels
from plugins.augment.safi import Safi
from plugins.regularize.uar import Uar
from tests.record.fakes import make_config

OWN = {"budget", "fixed", "none"}  # plugins of this project


def names(configs: Sequence[dict[str, Any]]) -> list[str]:
    return [method.label for method in methods_of(configs)]


@pytest.mark.parametrize(
    ("method", "name"),
    [
        (PLAIN, "Baseline"),
        (Method("none", "uar"), "UAR"),
        (Method("safi", "uar", options=(("reg.p", "0.2"),)), "SAFI + UAR, reg.p=0.2"),
        (Method("none", "dropgaussian", limits=(("steps", "75"),)), "DropGaussian, steps=75"),
        (Method("none", "uar+far_fidelity"), "UAR + DAFE"),
        (Method(recipe="corgs_sweep"), "CoR-GS (plane sweep)"),
        (Method("mine", "none"), "mine"),
    ],
)
def test_display_names(method: Method, name: str) -> None:
    """A plugin without a title has its registry name."""
    assert str(method) == method.name == name


@pytest.mark.parametrize("text", ["uar", "UAR", "none + uar", "None+UAR"])
def test_a_method_is_called_by_display_or_registry_name(text: str) -> None:
    assert Method("none", "uar").is_called(text)
    assert not Method("safi", "uar").is_called(text)
    assert Method("safi", "uar").is_called("safi_uar") and PLAIN.is_called("Baseline")


def test_every_plugin_names_its_paper() -> None:
    for group in (*GROUPS, "init"):
        for name, cls in table(group).items():
            if name not in OWN and cls.__module__.startswith("plugins."):
                (entry,) = bibtex(papers(group, name)).split("\n\n")[-1:]
                assert papers(group, name) and entry.startswith("@article{"), name
    assert all(entry.paper for entry in literature() if entry.recipe)


@pytest.mark.parametrize(
    "neutral",
    [{"threads": 2}, {"study": "x"}, {"force": True}, {"scene": {"name": "llff"}}],
)
def test_seed_scene_and_neutral_keys_are_no_method(neutral: dict[str, Any]) -> None:
    assert names([make_config(), make_config(seed=3, **neutral)]) == ["none + none"] * 2


def test_an_old_record_is_the_method_with_the_default() -> None:
    old = make_config("safi")
    new, other = (
        old | {"augment": {"name": "safi", "weight": 1.0, "eta": eta}} for eta in (Safi().eta, 9.0)
    )
    assert names([old, new]) == ["safi + none"] * 2
    of_default, of_other = f"safi + none, augment.eta={Safi().eta}", "safi + none, augment.eta=9.0"
    assert names([old, new, other]) == [of_default, of_default, of_other]
    name = "uar+binocular"
    old = make_config() | {"reg": {"name": name, "uar": {}, "binocular": {"weight": 1.0}}}
    new = make_config() | {"reg": {"name": name, "uar": {"p": 0.9}, "binocular": {"weight": 1.0}}}
    assert names([old, new]) == [f"none + {name}, reg.uar.p={p}" for p in (Uar().p, 0.9)]
    unknown = [make_config("mine"), make_config(augment={"name": "mine", "eta": 2.0})]
    assert names(unknown)[0].startswith("mine + none")


def test_steps_that_a_time_limit_replaced_are_not_named() -> None:
    trainers = [{"steps": 20, "seconds": 0.0}, {"steps": 20, "seconds": 5.0}, {"steps": 75}]
    trainers[2] |= {"visits": 4, "seconds": 9.0}
    configs = [make_config(trainer={**trainer, "members": 1}) for trainer in trainers]
    assert names(configs) == [
        "none + none, trainer.seconds=0.0, steps=20",
        "none + none, trainer.seconds=5.0",
        "none + none, trainer.seconds=9.0",
    ]


def test_nor_are_such_steps_named_beside_a_recipe() -> None:
    runs = [("baseline", 0, 5.0, 20), ("corgs", 500, 5.0, 20), ("corgs", 500, 9.0, 75)]
    configs, words = [], []
    for recipe, sh_every, seconds, steps in runs:
        trainer = {"steps": steps, "seconds": seconds, "sh_every": sh_every}
        configs.append(make_config(trainer=trainer))
        words.append([f"method={recipe}", f"trainer.seconds={seconds:g}", f"trainer.steps={steps}"])
    methods, _ = name_methods(configs, words, ["fern"] * 3)
    assert [method.label for method in methods] == [
        "none + none, trainer.seconds=5",
        "corgs, trainer.seconds=5",
        "corgs, trainer.seconds=9",
    ]


def info(name: str, fingerprint: str) -> SceneInfo:
    return SceneInfo(name, "own", fingerprint * 32, ("a",), ("b",))


def scene_names(*scenes: tuple[dict[str, Any], SceneInfo | None]) -> list[str]:
    configs = [make_config() | {"scene": {"name": "llff", **options}} for options, _ in scenes]
    return [label.full for label in scene_labels(configs, [actual for _, actual in scenes])]


def test_names_of_scenes() -> None:
    three, six = ({"n_views": 3}, info("fern", "33")), ({"n_views": 6}, info("fern", "66"))
    assert scene_names(three, six) == ["fern (n_views=3)", "fern (n_views=6)"]
    assert scene_names(three, ({"n_views": 3}, info("door", "77"))) == ["fern", "door"]
    edited = [({"n_views": 3}, info("fern", mark)) for mark in ("33", "66")]
    assert scene_names(*edited) == ["fern (33333333)", "fern (66666666)"]
    old = [({}, info("embedded", "00")), ({"texture": 1.0}, info("embedded", "00"))]
    assert len(set(scene_names(*old))) == 2, "llff has no such option, so nothing is its default"


OPTIONS = (("trainer.sh_every", "500"),)
OTHER = Method("none", "co_register", options=OPTIONS, capacity=(("capacity", "adc+co_prune"),))
FIRST = Method(options=(("trainer.sh_every", "1000"),))


def test_methods_are_named_by_their_recipes_if_each_is_one() -> None:
    plain = FIRST, ["method=baseline", "seed=0"], "fern"
    other = OTHER, ["method=corgs", "seed=0"], "fern"
    actual = by_recipe([plain, other, (OTHER, ["seed=1", "method=corgs"], "fern")])
    assert actual == {FIRST: PLAIN, OTHER: Method(recipe="corgs")}
    assert by_recipe([plain, (OTHER, ["seed=0"], "fern")]) == {}  # one without
    assert by_recipe([plain, (OTHER, ["method=baseline"], "fern")]) == {}  # one recipe, two methods
    assert by_recipe([plain, other, (OTHER, ["method=segs"], "fern")]) == {}  # two, one method
    pairs = [(PLAIN, ["method=baseline"], "fern"), (Method("safi"), ["method=safi"], "fern")]
    assert by_recipe(pairs) == {}  # pairs say enough
    assert recipe_of(["preset=paper"]) == ""
