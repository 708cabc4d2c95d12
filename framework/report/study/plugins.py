"""What plugins say about themselves: display names, papers, variants, and defaults of options.

A record says nothing about an option that was added after the run: the option's default counts.
"""

import dataclasses
import functools
import re
import sys
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from framework.errors import UserError
from framework.options import TrainerOptions
from framework.registry import GROUPS, JOINED_BY, lookup, option_fields, plain_fields, table
from framework.report.study.words import Flat

Owner = tuple[str, str]  # of options: a group and the plugin's name
PARTS = ("scene", "depth", "init")


@functools.cache
def plugin(group: str, name: str) -> type | None:
    """The class behind `group=name`; None if it is not installed."""
    try:
        return lookup(group, name)
    except UserError:
        return None


@functools.cache
def variant(group: str, name: str) -> Any:
    """The `framework.plugin.Variant` that some plugin of the group declares; None without one."""
    try:
        classes = table(group).values()
    except UserError:
        return None
    variants = (getattr(cls, "variants", {}).get(name) for cls in classes)
    return next((one for one in variants if one is not None), None)


def as_variant(config: Flat) -> Flat:
    """The configuration with its regularizer as users call it, without the option that says so."""
    cls = plugin("reg", str(config.get("reg.name")))
    for name, one in getattr(cls, "variants", {}).items():
        key = f"reg.{one.option}"
        if key in config:
            rest = {k: v for k, v in config.items() if k != key}
            return {**rest, "reg.name": name} if config[key] == one.value else rest
    return config


def described(group: str, name: str) -> list[Any]:
    """The classes, or variants, behind a choice of one plugin or several joined ones."""
    names = name.split(JOINED_BY)
    return [variant(group, one) or plugin(group, one) for one in names]


def title(group: str, name: str) -> str:
    """The display name of a choice, such as "UAR"; the registry name without one."""
    names = name.split(JOINED_BY)
    titles = [getattr(one, "title", "") for one in described(group, name)]
    return " + ".join(shown or one for shown, one in zip(titles, names, strict=True))


def summary(group: str, name: str) -> str:
    """Return the first sentence of a plugin's file, without its name; "" if it has none."""
    cls = plugin(group, name)
    text = (sys.modules[cls.__module__].__doc__ or "") if cls else ""
    start, _, rest = text.partition("`: ")
    return re.split(r"\.\s|\.$| \([A-Z]+\)", rest)[0] if start == f"`{group}={name}" else ""


def papers(group: str, name: str) -> list[str]:
    """Return the citations of a choice's plugins: files of `conf/published` or BibTeX entries."""
    return [paper for one in described(group, name) if (paper := getattr(one, "paper", ""))]


def with_defaults(configs: Sequence[Flat]) -> list[Flat]:
    """The flat `configs`, each with the options that another one has of the same trainer or plugin.
    An unknown option, or one without a default, stays out."""
    keys: dict[Owner, set[str]] = defaultdict(set)
    for config in configs:
        for key in config:
            keys[_owner(key.partition(".")[0], config)].add(key)
    completed: list[Flat] = []
    for config in configs:
        full = dict(config)
        for owner in (_owner(group, config) for group in ("trainer", *GROUPS, *PARTS)):
            for key in sorted(keys.get(owner, set()) - config.keys()):
                values = _defaults(*owner)
                if key.partition(".")[2] in values:
                    full[key] = values[key.partition(".")[2]]
        completed.append(full)
    return completed


def _owner(group: str, config: Flat) -> Owner:
    return group, str(config.get(f"{group}.name"))


@functools.cache
def _defaults(group: str, name: str) -> Flat:
    """Option -> default of the trainer or a plugin; of several joined ones as `uar.p`."""
    if group == "trainer":
        return _values(plain_fields(TrainerOptions))
    values: dict[str, Any] = {}
    names = name.split(JOINED_BY)
    for one in names:
        cls = plugin(group, one)
        if cls is None:
            return {}
        fields = option_fields(cls) if group in GROUPS else plain_fields(cls)
        prefix = f"{one}." if len(names) > 1 else ""
        values |= {f"{prefix}{key}": value for key, value in _values(fields).items()}
    return values


def _values(fields: Sequence[tuple[str, Any, Any]]) -> dict[str, Any]:
    """Option -> default, as a composed configuration has it: 1 of a float is 1.0."""
    values: dict[str, Any] = {}
    for key, kind, field in fields:
        value = field.default
        if value is not dataclasses.MISSING:
            values[key] = float(value) if kind is float and type(value) is int else value
    return values
