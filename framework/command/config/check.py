"""Checks of a composed configuration, and suggestions for misplaced or misspelt options."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from framework import registry
from framework.command.config.schema import (
    GROUPS,
    METRICS,
    OBJECT_GROUPS,
    SCALARS,
    choices,
    rows,
)
from framework.errors import UserError, nearest_hint, require
from framework.metrics.values import measures
from framework.options import TrainerOptions
from framework.run import trackers

TRAINER = [option.name for option in fields(TrainerOptions)]
FEW = 4  # choices with an option that a hint names


def check(config: Mapping[str, Any]) -> None:
    """Raise UserError unless `config` (plain, resolved) describes a run that can start.

    No key may be unknown (Hydra accepts `+key=value`), and every group needs a choice. The chosen
    classes check their options. Reads no scene.
    """
    _check_keys("", config, [*SCALARS, "trainer", "metrics", *OBJECT_GROUPS])
    _check_keys("trainer.", config["trainer"], TRAINER)
    _check_keys("metrics.", config["metrics"], METRICS)
    _check_integers("", config)
    for group in OBJECT_GROUPS:
        options = config[group]
        require(
            isinstance(options, Mapping) and "name" in options,
            f"{group}: expected a choice, got none; add {group}=NAME, available:"
            f" {', '.join(choices(group))}",
        )
        if group in registry.GROUPS:
            registry.build_all(group, options)
        else:
            registry.part(group, options)
    measures(config["metrics"].get("also"))
    views = config["metrics"].get("views", 0)
    require(views >= 0, f"metrics.views: expected an integer >= 0, got {views}; 0 evaluates all")
    TrainerOptions(**config["trainer"])
    estimate = config.get("estimate", False)
    require(
        estimate in (True, False, "only"),
        f"estimate: expected true, false or only, got {estimate!r:.40}",
    )
    for key, advice in (("seed", "choose another"), ("threads", "0 uses all cores")):
        value = config[key]
        require(value >= 0, f"{key}: expected an integer >= 0, got {value}; {advice}")
    study = config["study"]
    require(
        study is None or re.fullmatch(r"\w[\w.-]*(/\w[\w.-]*)*", study) is not None,
        f"study: expected a folder name of letters, digits, _ . and -, or several joined by /, got"
        f" {study!r}; rename it",
    )
    trackers.ready(config.get("tracker"))


def _check_integers(prefix: str, options: Mapping[str, Any]) -> None:
    """Raise UserError for an integer that libraries and records cannot hold."""
    for key, value in options.items():
        if isinstance(value, Mapping):
            _check_integers(f"{prefix}{key}.", value)
        require(
            type(value) is not int or abs(value) < 2**63,
            f"{prefix}{key}: expected an integer below 2^63, got {value}; choose another",
        )


def _check_keys(prefix: str, keys: Iterable[str], expected: Iterable[str]) -> None:
    """Raise UserError for a key that a section does not have."""
    options = list(expected)
    for key in keys:
        if key not in options:
            advice = hint(prefix.rstrip("."), str(key), options)
            raise UserError(f"{prefix}{key}: unknown option; {advice}")


def hint(section: str, key: str, allowed: Iterable[str]) -> str:
    """Suggest the same name in another section, or a similar one in this section.

    Args:
        section: "" for the top level.
        key: the unknown option.
        allowed: options of the section.
    """
    offered = {*allowed} if section else {*allowed, *GROUPS}
    there = _places(section.partition(".")[0], key)
    return f"did you mean {there}? {_available(offered)}" if there else nearest_hint(key, offered)


def _places(section: str, key: str) -> str:
    """The places of an option with this name: `trainer.steps`, `augment.eta of augment=safi`."""
    sections = {"trainer": TRAINER, "metrics": [*METRICS]}
    places = [f"'{name}.{key}'" for name, options in sections.items() if key in options]
    groups = [section] if section in OBJECT_GROUPS else OBJECT_GROUPS
    for group in groups:
        names = choices(group)
        having = [name for name in names if key in (row[0] for row in rows(group, name))]
        if having:
            few = having[:FEW] + ["..."] * (len(having) > FEW)
            of = "" if len(having) == len(names) else f" of {group}={', '.join(few)}"
            places.append(f"'{group}.{key}'{of}")
    return " or ".join(places)


def _available(names: Iterable[str]) -> str:
    return f"available: {', '.join(sorted(names))}"
