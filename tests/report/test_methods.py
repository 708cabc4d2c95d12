"""Methods and scenes as values: what differs is named, what cannot matter is not."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml

from framework.records.record import SceneInfo
from framework.registry import GROUPS, table
from framework.report.study.methods import (
    PLAIN,
    USUAL,
    Method,
    by_recipe,
    methods_of,
    recipe_of,
)
from framework.report.study.plugins import BEFORE, papers
from framework.report.study.published import bibtex
from framework.report.study.published import by_recipe as published
from framework.report.study.scenes import CHOSE, HELPED, TESTS, YOURS, marked, role, scene_labels
from framework.report.study.words import joined, listed, value_text
from plugins.augment.safi import Safi
from plugins.regularize.uar import Uar
from tests.cli.conftest import composed
from tests.record.fakes import make_config

CONF = Path(__file__).parents[2] / "conf"
OWN = {"budget", "fixed", "none"}  # plugins of this project


def names(configs: Sequence[dict[str, Any]]) -> list[str]:
    return [method.label for method in methods_of(configs)]


def test_methods_are_named_by_augmenter_and_regularizer() -> None:
    configs = [make_config(), make_config("safi", "uar"), make_config("safi", "uar", seed=5)]
    assert names(configs) == ["none + none", "safi + uar", "safi + uar"]


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
    assert all(entry.paper for entry in published().values())


@pytest.mark.parametrize("file", sorted((CONF / "reg").glob("*.yaml")), ids=lambda f: f.stem)
def test_a_variant_is_named_as_users_call_it(file: Path) -> None:
    content = yaml.safe_load(file.read_text(encoding="utf-8"))
    plugin = content.pop("defaults")[0]
    one = table("reg")[plugin].variants[file.stem]  # type: ignore[attr-defined]
    variant = make_config() | {"reg": {"name": plugin, **content}}
    plain = make_config() | {"reg": {"name": plugin, one.option: "another"}}
    assert (
        names([variant]) == [f"none + {file.stem}"] and methods_of([variant])[0].name == one.title
    )
    both = names([variant, plain])
    assert [name.partition(",")[0] for name in both] == [f"none + {file.stem}", f"none + {plugin}"]
    assert not any(one.option in name for name in both)


@pytest.mark.parametrize(
    "neutral",
    [{"threads": 2}, {"study": "x"}, {"force": True}, {"scene": {"name": "llff"}}],
)
def test_seed_scene_and_neutral_keys_are_no_method(neutral: dict[str, Any]) -> None:
    assert names([make_config(), make_config(seed=3, **neutral)]) == ["none + none"] * 2


def test_every_other_difference_is_named() -> None:
    labels = names(
        [
            make_config(trainer={"steps": 300, "sh_degree": 0}),
            make_config(capacity={"name": "adc", "weight": 1.0, "every": 100}),
            make_config(init={"name": "stereo", "budget": 5000}),
        ]
    )
    assert labels == [
        "none + none, budget=40000, steps=300",
        "none + none, budget=40000, steps=800, capacity=adc",
        "none + none, budget=5000, steps=800",
    ]


def test_options_only_count_among_runs_of_one_plugin() -> None:
    def uar(**options: Any) -> dict[str, Any]:
        return make_config() | {"reg": {"name": "uar", "weight": 1.0, **options}}

    assert names([make_config(), uar(p=0.2)]) == ["none + none", "none + uar"]
    assert names([make_config(), uar(p=0.2), uar(p=0.3)]) == [
        "none + none",
        "none + uar, reg.p=0.2",
        "none + uar, reg.p=0.3",
    ]


def test_a_draw_with_the_value_of_the_seed_needs_no_name() -> None:
    def draw(seed: int, of: int, corruption: str = "noise") -> dict[str, Any]:
        depth = {"name": "plane_sweep", "corruption": corruption, "corruption_seed": of}
        return make_config(seed=seed) | {"depth": depth}

    drawn = [draw(seed, seed) for seed in (0, 1, 2)]
    assert names(drawn) == ["none + none"] * 3
    clean = [draw(seed, 0, "none") for seed in (0, 1, 2)]
    assert names([*clean, *drawn]) == ["none + none"] * 6
    assert len(set(names([draw(seed, of) for seed in (0, 1) for of in (0, 1)]))) == 2
    steps = [make_config(seed=k, trainer={"steps": 300, "sh_degree": k}) for k in (0, 1)]
    assert len(set(names(steps))) == 2, "an option that happens to equal the seed"


def test_an_option_that_two_plugins_share_is_named_where_it_differs() -> None:
    def capacity(name: str, **options: Any) -> dict[str, Any]:
        return make_config() | {"capacity": {"name": name, "weight": 1.0, **options}}

    evidence = [capacity("evidence", every=share, grow=1.0) for share in (0.1, 0.2)]
    assert names([capacity("adc", every=50), *evidence]) == [
        "none + none, capacity=adc",
        "none + none, capacity=evidence, every=0.1",
        "none + none, capacity=evidence, every=0.2",
    ]
    assert names(evidence)[0] == "none + none, capacity.every=0.1"


def test_budgets_are_apart_from_the_family() -> None:
    configs = [make_config("safi", trainer={"steps": steps}) for steps in (100, 400)]
    methods = methods_of(configs)
    assert {method.family for method in methods} == {Method("safi")}
    assert [method.budget for method in methods] == [(("steps", "100"),), (("steps", "400"),)]


def test_unnamed_choices_are_the_defaults() -> None:
    config = composed()
    # a capacity is unnamed where it leaves the number of Gaussians alone, whatever the default is
    usual = {key: name for key, name in USUAL.items() if key != "capacity.name"}
    assert {key: config[key.partition(".")[0]]["name"] for key in usual} == usual


def test_what_the_steps_determine_needs_no_name() -> None:
    presets = [(75, 1.0), (100, 0.5), (300, 0.25)]
    configs = [make_config(trainer={"steps": s, "coarse_until": c}) for s, c in presets]
    watched = make_config(trainer={"steps": 100, "coarse_until": 0.5, "evaluations": 3})
    assert names([*configs, watched]) == [
        *(f"none + none, steps={steps}" for steps, _ in presets),
        "none + none, steps=100",
    ]
    other = make_config(trainer={"steps": 300, "coarse_until": 0.5})
    assert "none + none, coarse_until=0.5, steps=300" in names([*configs, other])


def test_rates_that_go_with_a_budget_need_no_name() -> None:
    presets = [(75, 1.0, 0.1), (75, 0.5, 0.2), (300, 0.25, 0.1)]
    configs = [
        make_config(trainer={"steps": s, "coarse_until": c, "lr_final": r}) for s, c, r in presets
    ]
    assert names(configs) == [f"none + none, coarse_until={c}, steps={s}" for s, c, _ in presets]
    tried = make_config(trainer={"steps": 75, "coarse_until": 0.5, "lr_final": 0.3})
    assert names([*configs, tried])[-1].startswith("none + none, trainer.lr_final=0.3, coarse_unt")


def test_members_are_a_budget_and_named_only_where_the_steps_do_not_tell() -> None:
    def config(steps: int, members: int) -> dict[str, Any]:
        ours = {"steps": steps, "members": members, "tuning": 0.05}
        return {"augment": {"name": "none"}, "reg": {"name": "none"}, "trainer": ours}

    several = names([config(100, 1), config(300, 1), config(450, 2)])
    assert several == [f"none + none, steps={n}" for n in (100, 300, 450)]
    two = names([config(300, 1), config(300, 2)])
    assert two == ["none + none, members=1", "none + none, members=2, tuning=0.05"]


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


def test_what_was_done_before_an_option_that_acts_by_default() -> None:
    """A record without it did not use the current default; the same for every such option."""
    for (group, plugin), values in BEFORE.items():
        of_group = {"name": plugin} if plugin else {}
        for key, before in values.items():
            old, new, same = (
                make_config() | {group: {**make_config().get(group, {}), **of_group, **more}}
                for more in ({}, {key: 7}, {key: before})
            )
            old[group].pop(key, None)
            actual = names([old, new, same])
            assert actual[0] == actual[2] != actual[1], (group, plugin, key)
            assert f"{key}={value_text(before)}" in actual[0], actual


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


def test_a_corrupted_depth_is_a_condition_and_no_method() -> None:
    configs = [
        make_config() | {"depth": {"name": "file", "corruption": kind, "strength": s}}
        for kind, s in (("noise", 0.1), ("noise", 0.2), ("bias", 0.1))
    ]
    assert names(configs) == ["none + none"] * 3
    labels = scene_labels(configs, [info("embedded", "11")] * 3)
    assert [label.full for label in labels] == [
        "embedded (corruption=noise, strength=0.1)",
        "embedded (corruption=noise, strength=0.2)",
        "embedded (corruption=bias, strength=0.1)",
    ]
    assert labels[0].without("strength") == "embedded (corruption=noise)"


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (("embedded", "llff_fern", "lund_door", "nerf_fox", "dtu_scan24"), CHOSE),
        (("llff_horns", "llff_fortress", "llff_room"), TESTS),
        (("mip360_kitchen", "dtu_scan65"), HELPED),
        (("kitchen", "my room"), YOURS),
    ],
)
def test_every_scene_has_its_role(names: tuple[str, ...], expected: str) -> None:
    assert {role(name) for name in names} == {expected}
    assert {marked(n, n) == f"{n} °" for n in names} == {expected == CHOSE}


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


def test_a_recipe_with_other_options_on_another_scene_is_one_method() -> None:
    there = Method("none", "co_register", options=(("reg.start", "0.2"),))
    runs = [
        (FIRST, ["method=baseline", "scene=llff"], "fern"),
        (FIRST, ["method=baseline", "scene=dtu"], "scan 65"),
        (OTHER, ["method=corgs", "scene=llff"], "fern"),
        (there, ["method=corgs", "scene=dtu"], "scan 65"),
    ]
    actual = by_recipe(runs)
    assert actual[OTHER] == actual[there] == Method(recipe="corgs")
    named = by_recipe([*runs[:3], (there, ["method=corgs", "trainer.steps=600"], "scan 65")])
    assert named[there].label == "corgs, steps=600" != named[OTHER].label


def test_what_was_typed_with_a_recipe_is_in_its_name() -> None:
    run = ["study=x", "seed=0", "scene.n_views=3", "hydra.sweep.dir=y"]
    binocular = (("trainer.binocular", "1.0"),)
    spare = Method("none", "cycle_warp", options=(*binocular, ("trainer.opacity_spare", "0.5")))
    longer = Method("none", "cycle_warp", options=binocular, limits=(("steps", "600"),))
    idea = Method("none", "cycle_warp", options=binocular)
    runs = [
        (FIRST, ["method=baseline", *run], "fern"),
        (idea, ["method=icogs_here", *run], "fern"),
        (spare, ["method=icogs_here", "trainer.opacity_spare=0.5", *run], "fern"),
        (longer, ["method=icogs_here", *run, "trainer.steps=600"], "fern"),
    ]
    actual = by_recipe(runs)
    assert actual[spare].label == "icogs_here, trainer.opacity_spare=0.5"
    assert actual[longer] == Method(recipe="icogs_here", limits=(("steps", "600"),))
    presets = [(m, [*words, f"preset={k}"], s) for k, (m, words, s) in enumerate(runs)]
    assert by_recipe(presets) == {}, "a preset is many options"


def test_names_with_commas_are_apart_in_a_list() -> None:
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(["a", "b, steps=300", "c"]) == "a; b, steps=300 and c"
    assert joined(["a", "b, steps=300", "c"]) == "a; b, steps=300; c"
    assert (
        listed(["fern (n_views=3, split=llff)", "fox"], "or")
        == "fern (n_views=3, split=llff) or fox"
    )
