"""Names of recipes: a study of them, as `sweep=literature`, calls its methods by the word `method=`
of their runs, as what sets them apart are many options of which none tells what was meant."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from framework.report.study.labels import MethodLabel
from framework.report.study.order import BASELINE

PLAIN = "baseline"  # keeps its name, by which it is found
NOTE = "Methods are named by their recipes; what each sets is in `conf/method/NAME.yaml`."


def recipe_of(overrides: Sequence[str]) -> str:
    """The name behind `method=` on a run's command line, "" without one."""
    for override in overrides:
        key, _, value = override.partition("=")
        if key == "method":
            return value
    return ""


def by_recipe(runs: Sequence[tuple[MethodLabel, Sequence[str]]]) -> dict[str, MethodLabel]:
    """Of runs, (label, overrides): the full name -> a label of the recipe's name alone.

    Empty unless every run has a recipe, each recipe is one method and the other way round, and
    there is more to them than an augmenter and a regularizer.
    """
    names: dict[str, set[str]] = defaultdict(set)
    for label, overrides in runs:
        names[label.full].add(recipe_of(overrides))
    chosen = [name for found in names.values() for name in found]
    if "" in chosen or len(set(chosen)) < len(chosen) or len(chosen) > len(names):
        return {}
    if not any(label.options or label.budget for label, _ in runs):
        return {}
    return {
        full: MethodLabel(BASELINE if name == PLAIN else name)
        for full, (name,) in ((full, tuple(found)) for full, found in names.items())
    }
