"""A study of recipes calls its methods by them."""

from __future__ import annotations

from framework.report.study.labels import MethodLabel
from framework.report.study.order import BASELINE
from framework.report.study.recipes import by_recipe, recipe_of

PLAIN = MethodLabel("none + none", "trainer.sh_every=1000", "", "adc")
OTHER = MethodLabel("none + co_register", "trainer.sh_every=500", "", "adc+co_prune")


def test_methods_are_named_by_their_recipes_if_each_is_one() -> None:
    plain, other = (PLAIN, ["method=baseline", "seed=0"]), (OTHER, ["method=corgs", "seed=0"])
    found = by_recipe([plain, other, (OTHER, ["seed=1", "method=corgs"])])
    assert found == {PLAIN.full: MethodLabel(BASELINE), OTHER.full: MethodLabel("corgs")}
    assert by_recipe([plain, (OTHER, ["seed=0"])]) == {}  # one without
    assert by_recipe([plain, (OTHER, ["method=baseline"])]) == {}  # one recipe, two methods
    assert by_recipe([plain, other, (OTHER, ["method=segs"])]) == {}  # two recipes, one method
    pairs = [(MethodLabel(name), [f"method={name}"]) for name in ("none + none", "safi + uar")]
    assert by_recipe(pairs) == {}  # pairs tell enough
    assert recipe_of(["preset=paper"]) == ""
