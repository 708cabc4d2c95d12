"""Names of recipes: a study of them, as `sweep=literature`, calls its methods by the word `method=`
of their runs, as what sets them apart are many options of which none tells what was meant."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import TypeVar

from framework.report.study.axes import BUDGETS
from framework.report.study.labels import MethodLabel, names_a_method
from framework.report.study.order import BASELINE

T = TypeVar("T")
SETS_MANY = ("preset", "sweep")  # of which one word is many options
PLAIN = "baseline"  # keeps its name, by which it is found
NOTE = (
    "Methods are named by their recipes; what each sets is in `conf/method/NAME.yaml`, and where a"
    " data set asks for others in `conf/for_scene/`."
)


def recipe_of(overrides: Sequence[str]) -> str:
    """The name behind `method=` on a run's command line, "" without one."""
    for override in overrides:
        key, _, value = override.partition("=")
        if key == "method":
            return value
    return ""


def by_recipe(runs: Sequence[tuple[MethodLabel, Sequence[str], str]]) -> dict[str, MethodLabel]:
    """Of runs, (label, overrides, scene): the full name -> a label of the recipe's name, with what
    else was typed where one recipe was run in several ways on a scene. On another scene it may have
    other options (`conf/for_scene`), and so another full name, and is the same method.

    Empty unless every run has a recipe, on each scene each name is one method and the other way
    round, and there is more to them than an augmenter, a regularizer and what was typed.
    """
    names: dict[str, set[str]] = defaultdict(set)
    typed: dict[str, set[tuple[str, ...]]] = defaultdict(set)
    scenes: dict[str, set[str]] = defaultdict(set)
    for label, overrides, scene in runs:
        names[label.full].add(recipe_of(overrides))
        typed[label.full].add(_of_method(overrides))
        scenes[label.full].add(scene)
    chosen = [name for found in names.values() for name in found]
    if "" in chosen or len(chosen) > len(names):
        return {}
    labels = {label.full: label for label, _, _ in reversed(runs)}  # failed ones come last
    simple = {full: _named(name) for full, (name,) in _only(names).items()}
    if _apart(simple, scenes) and _alike(simple, typed):
        told = any(label.options or label.budget for label in labels.values())
        return simple if told else {}
    return _with_words(labels, names, typed, scenes)


def _apart(found: Mapping[str, MethodLabel], scenes: Mapping[str, set[str]]) -> bool:
    """Whether no two methods of one scene have the same new name."""
    cells = [(label.full, scene) for full, label in found.items() for scene in scenes[full]]
    return len(set(cells)) == len(cells)


def _alike(found: Mapping[str, MethodLabel], typed: Mapping[str, set[tuple[str, ...]]]) -> bool:
    """Whether the same was typed wherever several methods have one new name."""
    ways: dict[str, list[set[tuple[str, ...]]]] = defaultdict(list)
    for full, label in found.items():
        ways[label.full].append(typed[full])
    return all(len(set.union(*each)) == 1 for each in ways.values() if len(each) > 1)


def _with_words(
    labels: Mapping[str, MethodLabel],
    names: Mapping[str, set[str]],
    typed: Mapping[str, set[tuple[str, ...]]],
    scenes: Mapping[str, set[str]],
) -> dict[str, MethodLabel]:
    """Names with the words that tell runs of one recipe apart; see `by_recipe`."""
    if any(len(ways) > 1 for ways in typed.values()):
        return {}
    words = {full: ways[0] for full, ways in _only(typed).items()}
    shared = set.intersection(*(set(own) for own in words.values()))
    words = {full: tuple(w for w in own if w not in shared) for full, own in words.items()}
    if any(word.partition("=")[0] in SETS_MANY for own in words.values() for word in own):
        return {}
    if all(_explained(labels[full], own) for full, own in words.items()):
        return {}
    found = {full: _named(name, words[full]) for full, (name,) in _only(names).items()}
    return found if _apart(found, scenes) else {}


def _of_method(overrides: Sequence[str]) -> tuple[str, ...]:
    """What was typed of the method beside its recipe, in order."""
    left = [word.lstrip("+") for word in overrides]
    return tuple(sorted(w for w in left if w.partition("=")[0] != "method" and names_a_method(w)))


def _explained(label: MethodLabel, words: Sequence[str]) -> bool:
    """Whether all that the label names was typed."""
    keys = {word.partition("=")[0] for word in words}
    known = keys | {key.rpartition(".")[2] for key in keys}
    parts = ", ".join(filter(None, (label.options, label.budget)))
    return all(part.partition("=")[0] in known for part in filter(None, parts.split(", ")))


def _named(recipe: str, words: Sequence[str] = ()) -> MethodLabel:
    keys = {word: word.partition("=")[0] for word in words}
    limits = [
        f"{keys[word].rpartition('.')[2]}={word.partition('=')[2]}"
        for word in words
        if keys[word] in BUDGETS
    ]
    options = [word for word in words if keys[word] not in BUDGETS]
    return MethodLabel(
        BASELINE if recipe == PLAIN else recipe, ", ".join(options), ", ".join(limits)
    )


def _only(found: Mapping[str, set[T]]) -> dict[str, tuple[T, ...]]:
    return {key: tuple(values) for key, values in found.items()}
