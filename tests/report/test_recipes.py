"""A study of recipes calls its methods by them."""

from __future__ import annotations

from framework.report.study.labels import MethodLabel
from framework.report.study.order import BASELINE
from framework.report.study.recipes import by_recipe, recipe_of

PLAIN = MethodLabel("none + none", "trainer.sh_every=1000", "", "adc")
OTHER = MethodLabel("none + co_register", "trainer.sh_every=500", "", "adc+co_prune")


def test_methods_are_named_by_their_recipes_if_each_is_one() -> None:
    plain = PLAIN, ["method=baseline", "seed=0"], "fern"
    other = OTHER, ["method=corgs", "seed=0"], "fern"
    found = by_recipe([plain, other, (OTHER, ["seed=1", "method=corgs"], "fern")])
    assert found == {PLAIN.full: MethodLabel(BASELINE), OTHER.full: MethodLabel("corgs")}
    assert by_recipe([plain, (OTHER, ["seed=0"], "fern")]) == {}  # one without
    assert by_recipe([plain, (OTHER, ["method=baseline"], "fern")]) == {}  # one recipe, two methods
    segs = OTHER, ["method=segs"], "fern"
    assert by_recipe([plain, other, segs]) == {}  # two recipes, one method
    pairs = [
        (MethodLabel(name), [f"method={name}"], "fern") for name in ("none + none", "safi + uar")
    ]
    assert by_recipe(pairs) == {}  # pairs tell enough
    assert recipe_of(["preset=paper"]) == ""


def test_a_recipe_with_other_options_on_another_scene_is_one_method() -> None:
    there = MethodLabel("none + co_register", "reg.start=0.2", "", "adc+co_prune")
    runs = [
        (PLAIN, ["method=baseline", "scene=llff"], "fern"),
        (PLAIN, ["method=baseline", "scene=dtu"], "scan 65"),
        (OTHER, ["method=corgs", "scene=llff"], "fern"),
        (there, ["method=corgs", "scene=dtu"], "scan 65"),
    ]
    found = by_recipe(runs)
    assert found[OTHER.full] == found[there.full] == MethodLabel("corgs")
    longer = there, ["method=corgs", "scene=dtu", "trainer.steps=600"], "scan 65"
    named = by_recipe([*runs[:3], longer])
    assert named[there.full].full == "corgs, steps=600" != named[OTHER.full].full


def test_what_was_typed_beside_a_recipe_is_in_its_name() -> None:
    run = ["study=x", "seed=0", "scene.n_views=3", "preset=best", "hydra.sweep.dir=y"]
    spare = MethodLabel("none + cycle_warp", "trainer.binocular=1.0, trainer.opacity_spare=0.5")
    longer = MethodLabel("none + cycle_warp", "trainer.binocular=1.0", "steps=600")
    coarse = MethodLabel("none + cycle_warp", "trainer.binocular=1.0", "coarse_until=0.5")
    plain = MethodLabel("none + none", "trainer.binocular=1.0")
    runs = [
        (plain, ["method=baseline", *run]),
        (MethodLabel("none + cycle_warp", "trainer.binocular=1.0"), ["method=icogs_here", *run]),
        (spare, ["method=icogs_here", "trainer.opacity_spare=0.5", *run]),
        (longer, ["method=icogs_here", *run, "trainer.steps=600"]),
        (coarse, ["method=icogs_here", *run, "trainer.coarse_until=0.5"]),
    ]
    found = by_recipe([(*run, "fern") for run in runs])
    assert found[plain.full] == MethodLabel(BASELINE)
    assert found[spare.full].full == "icogs_here, trainer.opacity_spare=0.5"
    assert found[longer.full] == MethodLabel("icogs_here", "", "steps=600")
    assert found[coarse.full] == MethodLabel("icogs_here", "", "coarse_until=0.5")
    explained = [
        (MethodLabel("safi + none", f"augment.eta={k}"), ["method=safi", f"augment.eta={k}"], "x")
        for k in (1, 2)
    ]
    assert by_recipe(explained) == {}, "an augmenter, a regularizer and what was typed say it all"
    presets = [(label, [*words, f"preset={k}"], "x") for k, (label, words) in enumerate(runs)]
    assert by_recipe(presets) == {}, "a preset is many options"
