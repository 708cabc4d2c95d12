"""Names of methods and scenes among the runs of a study: what differs is named, nothing else.

A method is what a user compares: augmenter and regularizer, plus every other option that differs
between the runs: another capacity plugin, depth provider or initializer, an option of a plugin
that differs between runs of the same plugin, `trainer.steps`, and so on; the default choices of
these groups (`USUAL`, of capacities the one that changes nothing) need no name. The seed, what has
its value (`depth.corruption_seed=${seed}`), the scene, the stresses of
`framework.report.study.axes` and keys that cannot change a result (`NEUTRAL_KEYS`) are no part of
it. An option that a record lacks has its default (`framework.report.study.defaults`).
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from framework.errors import printable_line
from framework.records.provenance import NEUTRAL_KEYS
from framework.records.record import METHOD_GROUPS, SceneInfo
from framework.report.study.axes import BUDGETS, DATA_KEYS, VIEWS
from framework.report.study.defaults import with_defaults
from framework.scenes import ALL

NAMED = ("augment", "reg")  # groups every method's name starts with
WITH_STEPS = (  # what presets set beside the steps
    *("trainer.coarse_factor", "trainer.coarse_until"),
    *("trainer.members", "trainer.tuning", "trainer.visits"),
)
RATES = ("trainer.lr_final", "trainer.lr_means_final", "trainer.lr_scales")  # and beside these
RASTERIZER, NUMBA = "rasterizer.name", "numba"  # the only one of records without the key
USUAL = {  # unnamed
    **{"capacity.name": "fixed", "init.name": "stereo", "depth.name": "plane_sweep"},
    RASTERIZER: NUMBA,
}
VARIANTS = {  # plugins that one option makes another method, as `conf/reg/` names it
    ("uniform", "reg.compensate", True): "dropgaussian",
    ("uar", "reg.mode", "hard"): "uar_hard",
    ("co_register", "reg.second_drawn", True): "co_register_drawn",
}
NO_METHOD = ("seed", "scene", "metrics", *NEUTRAL_KEYS)
WATCHING = ("trainer.evaluations",)  # changes what is told, not what comes out
UNKNOWN_SCENE = "unknown scene"

Flat = Mapping[str, Any]


@dataclass(frozen=True)
class MethodLabel:
    """full: the name. family: the name without budgets. pair: augmenter and regularizer alone.
    options, limits, capacity: the other parts, "" where there is none; the last two, steps and
    their like and how the number of Gaussians is decided, are its budget."""

    pair: str
    options: str = ""
    limits: str = ""
    capacity: str = ""

    @property
    def family(self) -> str:
        return ", ".join(filter(None, (self.pair, self.options)))

    @property
    def budget(self) -> str:
        return ", ".join(filter(None, (self.limits, self.capacity)))

    @property
    def without_capacity(self) -> str:
        return ", ".join(filter(None, (self.family, self.limits)))

    @property
    def full(self) -> str:
        return ", ".join(filter(None, (self.family, self.budget)))


@dataclass(frozen=True)
class SceneLabel:
    """full: the name with all that tells it from others of its name. data: the values of the
    stresses and conditions (`DATA_KEYS`) that it has."""

    full: str
    name: str
    data: Flat

    def without(self, option: str) -> str:
        """`fern (split=llff)` of `fern (n_views=3, split=llff)` without `n_views`."""
        part = rf"{re.escape(option)}=[^,()]*"
        return re.sub(rf" \({part}\)$|(?<=\(){part}, |, {part}(?=[,)])", "", self.full)


def flatten(config: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Dotted keys of a nested config."""
    flat: dict[str, Any] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            flat |= flatten(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def method_labels(configs: Sequence[Mapping[str, Any]]) -> list[MethodLabel]:
    """The name of each run's method among `configs`; equal configs have equal names."""
    flat = [
        {RASTERIZER: NUMBA, **_by_variant(_without_idle_options(config))}
        for config in with_defaults([flatten(config) for config in configs])
    ]
    keys = [key for key in _keys(flat) if _may_name_a_method(key)]
    keys = _without_followers(keys, flat)
    where = {key: _varying(key, flat) for key in keys}
    told = [[key for key in keys if _plugin(key, entry) in where[key]] for entry in flat]
    return [_method_label(*pair) for pair in zip(flat, told, strict=True)]


def scene_labels(
    configs: Sequence[Mapping[str, Any]], scenes: Sequence[SceneInfo | None]
) -> list[SceneLabel]:
    """The scene's name; where one name stands for several scenes or conditions, with what tells
    them apart. scenes: None for a run that failed before it was loaded."""
    flat = [
        _without_idle_strength(config)
        for config in with_defaults([flatten(config) for config in configs])
    ]
    names = _scene_names(configs, scenes)
    labels: list[SceneLabel | None] = [None] * len(flat)
    for name in set(names):
        own = [index for index, other in enumerate(names) if other == name]
        texts = _scene_texts(name, [flat[i] for i in own], [scenes[i] for i in own])
        for index, text in zip(own, texts, strict=True):
            labels[index] = SceneLabel(text, name, _data(flat[index], scenes[index]))
    return [label for label in labels if label is not None]


def _data(config: Flat, scene: SceneInfo | None) -> Flat:
    """The stresses and conditions of a config; of `all` views, how many these were."""
    data = {key: config[key] for key in DATA_KEYS if key in config}
    if scene is not None and data.get(VIEWS) == ALL:
        data[VIEWS] = len(scene.training)
    return data


def text_of(value: Any) -> str:
    """An option's value as it is shown."""
    return outside(value) if isinstance(value, str) else json.dumps(value)


def outside(text: str) -> str:
    """A text from outside as one printable line of bounded length, without backticks, which a
    report gives a meaning."""
    return printable_line(" ".join(text.split())).replace("`", "'")


def code(text: str) -> str:
    """A text from outside as code; empty stays empty."""
    line = outside(text)
    return f"`{line}`" if line else ""


def _without_idle_strength(flat: Flat) -> Flat:
    """The strength of no corruption is no condition."""
    if flat.get("depth.corruption") != "none":
        return flat
    return {key: value for key, value in flat.items() if key != "depth.strength"}


def _scene_names(
    configs: Sequence[Mapping[str, Any]], scenes: Sequence[SceneInfo | None]
) -> list[str]:
    """A scene that was not loaded is called as where the same loader opened the same folder."""
    given = [config.get("scene") or {} for config in configs]
    asked = [(options.get("name", UNKNOWN_SCENE), options.get("path")) for options in given]
    known = {key: info.name for key, info in zip(asked, scenes, strict=True) if info}
    pairs = zip(asked, scenes, strict=True)
    return [outside(info.name if info else known.get(key, str(key[0]))) for key, info in pairs]


def _scene_texts(name: str, alike: Sequence[Flat], scenes: Sequence[SceneInfo | None]) -> list[str]:
    """A label for each of the runs `alike`, which all have a scene called `name`."""
    prints = {info.fingerprint for info in scenes if info}
    keys = [key for key in _keys(alike) if key in DATA_KEYS and _varies(key, alike)]
    if len(prints) > 1:
        keys += [
            key
            for key in _keys(alike)
            if key.startswith("scene.") and key not in keys and _varies(key, alike)
        ]
    named = [
        tuple(f"{k.rpartition('.')[2]}={text_of(e[k])}" for k in sorted(keys) if k in e)
        for e in alike
    ]
    found: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for parts, info in zip(named, scenes, strict=True):
        if info:
            found[parts].add(info.fingerprint)
    texts = []
    for parts, info in zip(named, scenes, strict=True):
        # the fingerprint settles what the options do not tell, such as edited images
        told = [info.fingerprint[:8]] if info and len(found[parts]) > 1 else []
        texts.append(f"{name} ({', '.join([*parts, *told])})" if parts or told else name)
    return texts


def _keys(flat: Sequence[Flat]) -> list[str]:
    return sorted(set().union(*flat))


def names_a_method(word: str) -> bool:
    """Whether an override, KEY=VALUE, is of a method and not of its data, the run or Hydra."""
    key = word.partition("=")[0]
    return _may_name_a_method(key) and not key.startswith("hydra/")


def _may_name_a_method(key: str) -> bool:
    group = key.partition(".")[0]
    return group not in NO_METHOD and key not in (*DATA_KEYS, *WATCHING)


def _varies(key: str, configs: Sequence[Flat]) -> bool:
    return bool(_varying(key, configs))


def _varying(key: str, configs: Sequence[Flat]) -> set[str | None]:
    """The plugins (None: of no plugin) among whose runs `key` differs: an option of a plugin only
    counts among runs of that plugin."""
    seen: dict[str | None, set[str]] = defaultdict(set)
    for config in configs:
        plugin = _plugin(key, config)
        if plugin is None or key in config:
            seen[plugin].add(text_of(config.get(key)))
    return {plugin for plugin, values in seen.items() if len(values) > 1}


def _plugin(key: str, config: Flat) -> str | None:
    """The plugin of `config` whose option `key` is, None if it is no plugin's."""
    group, _, option = key.partition(".")
    if group not in METHOD_GROUPS or option == "name":
        return None
    return str(config.get(f"{group}.name"))


def _without_idle_options(config: Flat) -> Flat:
    """A training without other members has nothing to tune, depth that is not spoiled no draw."""
    idle = set[str]()
    if config.get("trainer.members", 1) == 1:
        idle.add("trainer.tuning")
    if config.get("depth.corruption", "none") == "none" or config.get("depth.strength") == 0:
        idle.add("depth.corruption_seed")
    return {key: value for key, value in config.items() if key not in idle}


def _by_variant(config: Flat) -> Flat:
    """The config with its regularizer as users call it, without the option that says the same."""
    for (plugin, key, value), name in VARIANTS.items():
        if config.get("reg.name") == plugin and key in config:
            rest = {k: v for k, v in config.items() if k != key}
            return {**rest, "reg.name": name} if config[key] == value else rest
    return config


def _without_followers(keys: Sequence[str], configs: Sequence[Flat]) -> list[str]:
    """`keys` but those that others determine, as where presets set them: the steps what goes with
    them, both the rates; the seed what was given as `${seed}`."""
    followers = {key for key in WITH_STEPS if _follows(key, ["trainer.steps"], configs)}
    told = ["trainer.steps", *(key for key in WITH_STEPS if key not in followers)]
    followers |= {key for key in RATES if _follows(key, told, configs)}
    followers |= {key for key in keys if _is_the_seed(key, configs)}
    return [key for key in keys if key not in followers]


def _follows(key: str, others: Sequence[str], configs: Sequence[Flat]) -> bool:
    """Whether the values of the `others`, of which there are several, determine that of `key`."""
    seen: dict[tuple[str, ...], set[str]] = defaultdict(set)
    for config in configs:
        seen[tuple(text_of(config.get(o)) for o in others)].add(text_of(config.get(key)))
    return len(seen) > 1 and all(len(values) == 1 for values in seen.values())


def _is_the_seed(key: str, configs: Sequence[Flat]) -> bool:
    """Whether `key`, another seed, is the run's own in every run that has it, as `${seed}` is."""
    own = [config for config in configs if key in config]
    seeds = {config.get("seed") for config in own}
    alike = all(config[key] == config.get("seed") for config in own)
    return key.endswith("_seed") and len(seeds) > 1 and alike


def _method_label(config: Flat, told: Sequence[str]) -> MethodLabel:
    """told: the keys to be named. A capacity's options follow its name without the group's."""
    pair = " + ".join(text_of(config.get(f"{group}.name", "none")) for group in NAMED)
    options: list[str] = []
    limits: list[str] = []
    capacity: list[str] = []
    for key in sorted(told, key=lambda key: (key.startswith("capacity."), key != "capacity.name")):
        group, _, option = key.partition(".")
        if key in {f"{g}.name" for g in NAMED} or key not in config:
            continue
        if key in USUAL and config[key] == USUAL[key]:
            continue
        bare = key in BUDGETS or (group == "capacity" and capacity)
        name = group if option == "name" else option if bare else key
        parts = capacity if group == "capacity" else limits if key in BUDGETS else options
        parts.append(f"{name}={text_of(config[key])}")
    return MethodLabel(pair, *(", ".join(parts) for parts in (options, limits, capacity)))


def listed(items: Sequence[object], word: str) -> str:
    """`a, b and c`, with `word` before the last one."""
    *most, last = map(str, items)
    return f"{joined(most, beside=last)} {word} {last}" if most else last


def joined(items: Sequence[str], beside: str = "") -> str:
    """`a, b`; `a; b, steps=300` where a name, or one `beside` them, has a comma of its own."""
    own = any("," in re.sub(r"\(.*?\)", "", item) for item in (*items, beside))
    return ("; " if own else ", ").join(items)
