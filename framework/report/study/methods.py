"""Methods as values: what users compare, derived from what differs between the runs of a study.

A method is an augmenter and a regularizer, with every other option that differs between the runs.
Such options are another capacity plugin, depth provider or initializer, an option of a plugin,
`trainer.steps` and so on. Default choices (`USUAL`) need no name. A method does not include the
seed, options that follow it (`depth.corruption_seed=${seed}`), the scene, the stresses of
`framework.report.study.axes` and keys without effect on results.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from framework.records.provenance import NEUTRAL_KEYS
from framework.records.record import METHOD_GROUPS
from framework.report.study.axes import (
    BUDGETS,
    CHOSEN_BY_TIME,
    DATA_KEYS,
    SECONDS,
    STEPS,
    WITH_STEPS,
)
from framework.report.study.plugins import as_variant, title, with_defaults
from framework.report.study.published import recipe_title
from framework.report.study.words import Flat, flatten, natural, value_text

Option = tuple[str, str]  # name and value, as shown
BASELINE = "none + none"
LEARNED_MARK = "†"  # after the name of a method that used learned weights
NAMED = ("augment", "reg")
RATES = ("trainer.lr_final", "trainer.lr_means_final", "trainer.lr_scales")  # and with these
RASTERIZER, NUMBA = "rasterizer.name", "numba"  # the only one of records without the key
USUAL = {  # choices without a name
    **{"capacity.name": "fixed", "init.name": "stereo", "depth.name": "plane_sweep"},
    RASTERIZER: NUMBA,
}
NO_METHOD = ("seed", "scene", "metrics", *NEUTRAL_KEYS)
WATCHING = ("trainer.evaluations",)  # changes what is recorded, not the result
SETS_MANY = ("preset", "sweep")  # one word of a command line that sets many options
PLAIN_RECIPE = "baseline"
RECIPE_NOTE = (
    "Methods are named by their recipes (`conf/method/NAME.yaml`, with values for single data sets"
    " in `conf/for_scene/`)."
)


@dataclass(frozen=True)
class Method:
    """A method of a study.

    Attributes:
        augment, reg: names of the plugins; "none" without one.
        recipe: name in `conf/method` if it means more than the two plugins; else "".
        options: other options that differ between the runs.
        limits: steps and other limits; together with `capacity` the budget.
        capacity: the capacity plugin with its options that differ.
        learned: weights of a network trained on other scenes that its runs used; else "".
    """

    augment: str = "none"
    reg: str = "none"
    recipe: str = ""
    options: tuple[Option, ...] = ()
    limits: tuple[Option, ...] = ()
    capacity: tuple[Option, ...] = ()
    learned: str = field(default="", compare=False)  # follows from the configuration

    @cached_property
    def pair(self) -> Method:
        return Method(self.augment, self.reg, self.recipe, learned=self.learned)

    @cached_property
    def family(self) -> Method:
        """The method without its budget."""
        return replace(self, limits=(), capacity=())

    @property
    def budget(self) -> tuple[Option, ...]:
        return (*self.limits, *self.capacity)

    @property
    def without_capacity(self) -> Method:
        return replace(self, capacity=())

    @cached_property
    def label(self) -> str:
        """The method by registry names, as `none + uar, steps=300`; for files and sorting."""
        return self._with_options(self.recipe or f"{self.augment} + {self.reg}")

    @cached_property
    def name(self) -> str:
        """The display name, as `UAR, steps=300`, with a mark if weights were learned."""
        return f"{self._unmarked_name} {LEARNED_MARK}" if self.learned else self._unmarked_name

    @cached_property
    def _unmarked_name(self) -> str:
        plugins = [title(g, n) for g, n in self.plugins.items()]
        return self._with_options(recipe_title(self.recipe) or " + ".join(plugins) or "Baseline")

    @property
    def plugins(self) -> dict[str, str]:
        """The augmenter and the regularizer by group, as far as it has them."""
        if self.recipe:
            return {}
        return {g: n for g, n in (("augment", self.augment), ("reg", self.reg)) if n != "none"}

    def _with_options(self, head: str) -> str:
        options = (*self.options, *self.budget)
        return ", ".join([head, *(f"{key}={value}" for key, value in options)])

    def __str__(self) -> str:
        return self.name

    @cached_property
    def order(self) -> tuple[bool, bool, list[tuple[int, float, str]]]:
        """Sort key: the baseline, its variants, then the others by label."""
        return self != PLAIN, not self.label.startswith(BASELINE), natural(self.label)

    def is_called(self, text: str) -> bool:
        """Whether `text` is the label, display name or plugins (`uar`); ignores case and spaces."""
        head = self.recipe or "+".join(self.plugins.values()) or PLAIN_RECIPE
        names = {self.label, self.name, self._unmarked_name, self._with_options(head)}
        joined = set() if self.options or self.budget else {head.replace("+", "_")}
        return _squeezed(text) in {*map(_squeezed, names), *joined}


PLAIN = Method()


def learned_footnote(methods: Iterable[Method]) -> str:
    """The footnote of a table of methods that explains the mark; "" if none has it."""
    weights = sorted({method.learned for method in methods if method.learned})
    return f"{LEARNED_MARK} uses learned weights: {'; '.join(weights)}." if weights else ""


def _squeezed(text: str) -> str:
    return "".join(text.split()).lower()


def name_methods(
    configs: Sequence[Mapping[str, Any]], overrides: Sequence[Sequence[str]], scenes: Sequence[str]
) -> tuple[list[Method], list[str]]:
    """The method of each run, from its configuration, its command line and its scene's label; and
    notes on how they are named."""
    methods = methods_of(configs)
    words = list(map(_without_idle_words, overrides, configs))
    recipes = by_recipe(list(zip(methods, words, scenes, strict=True)))
    if recipes:
        return [recipes[method] for method in methods], [RECIPE_NOTE]
    return methods, []


def methods_of(configs: Sequence[Mapping[str, Any]]) -> list[Method]:
    """The method of each run among `configs`; equal configurations have equal methods."""
    flat = [
        {RASTERIZER: NUMBA, **as_variant(_without_idle_options(config))}
        for config in with_defaults([flatten(config) for config in configs])
    ]
    keys = _without_followers([key for key in all_keys(flat) if _may_name_a_method(key)], flat)
    plugins = {key: differing(key, flat) for key in keys}
    return [_method(c, [key for key in keys if _plugin(key, c) in plugins[key]]) for c in flat]


def _method(config: Flat, keys: Sequence[str]) -> Method:
    """keys: those to be named. A capacity's options follow its name without the group's."""
    options: list[Option] = []
    limits: list[Option] = []
    capacity: list[Option] = []
    for key in sorted(keys, key=lambda key: (key.startswith("capacity."), key != "capacity.name")):
        group, _, option = key.partition(".")
        unnamed = key in USUAL and config.get(key) == USUAL[key]
        if unnamed or key not in config or key in {f"{g}.name" for g in NAMED}:
            continue
        bare = key in BUDGETS or (group == "capacity" and capacity)
        name = group if option == "name" else option if bare else key
        parts = capacity if group == "capacity" else limits if key in BUDGETS else options
        parts.append((name, value_text(config[key])))
    augment, reg = (value_text(config.get(f"{group}.name", "none")) for group in NAMED)
    return Method(augment, reg, "", tuple(options), tuple(limits), tuple(capacity))


def all_keys(configs: Sequence[Flat]) -> list[str]:
    return sorted(set().union(*configs))


def _may_name_a_method(key: str) -> bool:
    return key.partition(".")[0] not in NO_METHOD and key not in (*DATA_KEYS, *WATCHING)


def differing(key: str, configs: Sequence[Flat]) -> set[str | None]:
    """The plugins (None: of no plugin) among whose runs `key` differs: an option of a plugin only
    counts among runs of that plugin."""
    seen: dict[str | None, set[str]] = defaultdict(set)
    for config in configs:
        plugin = _plugin(key, config)
        if plugin is None or key in config:
            seen[plugin].add(value_text(config.get(key)))
    return {plugin for plugin, values in seen.items() if len(values) > 1}


def _plugin(key: str, config: Flat) -> str | None:
    """The plugin of `config` whose option `key` is, None if it is no plugin's."""
    group, _, option = key.partition(".")
    if group not in METHOD_GROUPS or option == "name":
        return None
    return str(config.get(f"{group}.name"))


def _without_idle_options(config: Flat) -> Flat:
    """Without options that cannot act: nothing to tune in one training, depth that is not spoiled
    has no random draw, a time limit chooses the steps."""
    idle = set[str]()
    if config.get("trainer.members", 1) == 1:
        idle |= {"trainer.tuning", "trainer.kept"}
    if config.get("depth.corruption", "none") == "none" or config.get("depth.strength") == 0:
        idle.add("depth.corruption_seed")
    if _is_timed(config):
        idle |= set(CHOSEN_BY_TIME)
    return {key: value for key, value in config.items() if key not in idle}


def _is_timed(config: Flat) -> bool:
    """Whether a time limit chose the steps."""
    return config.get(SECONDS) not in (None, 0)


def _without_idle_words(words: Sequence[str], config: Mapping[str, Any]) -> list[str]:
    """The words of a run's command line, without the steps that a time limit replaced."""
    idle = CHOSEN_BY_TIME if _is_timed(flatten(config)) else ()
    return [word for word in words if word.lstrip("+").partition("=")[0] not in idle]


def _without_followers(keys: Sequence[str], configs: Sequence[Flat]) -> list[str]:
    """Remove keys whose values are a function of another key, so that names stay short.

    Rates set by a preset follow `trainer.steps`; `${seed}` follows `seed`.
    """
    followers = {key for key in WITH_STEPS if _follows(key, [STEPS], configs)}
    leaders = [STEPS, *(key for key in WITH_STEPS if key not in followers)]
    followers |= {key for key in RATES if _follows(key, leaders, configs)}
    followers |= {key for key in keys if _is_the_seed(key, configs)}
    return [key for key in keys if key not in followers]


def _follows(key: str, others: Sequence[str], configs: Sequence[Flat]) -> bool:
    """Whether the values of the `others`, of which there are several, determine that of `key`."""
    seen: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for config in configs:
        seen[tuple(value_text(config.get(o)) for o in others)].add(value_text(config.get(key)))
    return len(seen) > 1 and all(len(values) == 1 for values in seen.values())


def _is_the_seed(key: str, configs: Sequence[Flat]) -> bool:
    """Whether `key`, another seed, equals the run's seed in every run that has it."""
    having = [config for config in configs if key in config]
    seeds = {config.get("seed") for config in having}
    equal = all(config[key] == config.get("seed") for config in having)
    return key.endswith("_seed") and len(seeds) > 1 and equal


def recipe_of(overrides: Sequence[str]) -> str:
    """The value of `method=` on a run's command line, "" without one."""
    named = (word.partition("=") for word in overrides)
    return next((value for key, _, value in named if key == "method"), "")


@dataclass
class _Ways:
    """The command lines of a method's runs: recipes, other words of the method, scenes."""

    recipes: set[str]
    words: set[tuple[str, ...]]
    scenes: set[str]


def by_recipe(runs: Sequence[tuple[Method, Sequence[str], str]]) -> dict[Method, Method]:
    """Name methods by their recipes, for runs (method, overrides, scene).

    The name includes other words of the command line if one recipe was run in several ways on a
    scene. A recipe may have other options on another scene (`conf/for_scene`) and remains the same
    method.

    Returns:
        method -> named method. It is empty unless every run has a recipe, each name is one method
        on each scene, and recipes are more than an augmenter, a regularizer and the words on the
        command line.
    """
    ways: dict[Method, _Ways] = {}
    for method, overrides, scene in runs:
        way = ways.setdefault(method, _Ways(set(), set(), set()))
        way.recipes.add(recipe_of(overrides))
        way.words.add(_words_of_method(overrides))
        way.scenes.add(scene)
    if any("" in way.recipes or len(way.recipes) > 1 for way in ways.values()):
        return {}
    simple = {method: _recipe_method(next(iter(way.recipes)), ()) for method, way in ways.items()}
    if _is_distinct(simple, ways) and _is_consistent(simple, ways):
        return simple if any(method.options or method.budget for method in ways) else {}
    return _with_words(ways)


def _is_distinct(named: Mapping[Method, Method], ways: Mapping[Method, _Ways]) -> bool:
    """Whether no two methods of one scene have the same new name."""
    cells = [(new, scene) for old, new in named.items() for scene in ways[old].scenes]
    return len(set(cells)) == len(cells)


def _is_consistent(named: Mapping[Method, Method], ways: Mapping[Method, _Ways]) -> bool:
    """Whether methods that share a new name have the same words on all their command lines."""
    words: dict[Method, list[set[tuple[str, ...]]]] = defaultdict(list)
    for old, new in named.items():
        words[new].append(ways[old].words)
    return all(len(set.union(*each)) == 1 for each in words.values() if len(each) > 1)


def _with_words(ways: Mapping[Method, _Ways]) -> dict[Method, Method]:
    """Names with the words that distinguish runs of one recipe; see `by_recipe`."""
    if any(len(way.words) > 1 for way in ways.values()):
        return {}
    words = {method: next(iter(way.words)) for method, way in ways.items()}
    shared = set.intersection(*(set(words_of) for words_of in words.values()))
    words = {
        method: tuple(w for w in words_of if w not in shared) for method, words_of in words.items()
    }
    sets_many = any(
        w.partition("=")[0] in SETS_MANY for words_of in words.values() for w in words_of
    )
    if sets_many or all(_is_explained(method, words_of) for method, words_of in words.items()):
        return {}
    named = {m: _recipe_method(next(iter(way.recipes)), words[m]) for m, way in ways.items()}
    return named if _is_distinct(named, ways) else {}


def _words_of_method(overrides: Sequence[str]) -> tuple[str, ...]:
    """The words that set options of the method, without its recipe, sorted."""
    words = (word.lstrip("+") for word in overrides)

    def counts(key: str) -> bool:
        return key != "method" and _may_name_a_method(key) and not key.startswith("hydra/")

    return tuple(sorted(word for word in words if counts(word.partition("=")[0])))


def _is_explained(method: Method, words: Sequence[str]) -> bool:
    """Whether all options of the method are on the command line."""
    keys = {word.partition("=")[0] for word in words}
    explained = keys | {key.rpartition(".")[2] for key in keys}
    return all(name in explained for name, _ in (*method.options, *method.budget))


def _recipe_method(recipe: str, words: Sequence[str]) -> Method:
    pairs = [(key, value) for key, _, value in (word.partition("=") for word in words)]
    options = tuple(pair for pair in pairs if pair[0] not in BUDGETS)
    limits = tuple((key.rpartition(".")[2], value) for key, value in pairs if key in BUDGETS)
    return Method("none", "none", "" if recipe == PLAIN_RECIPE else recipe, options, limits)
