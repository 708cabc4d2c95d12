"""What a record says that was written before an option existed: nothing, so the option's default
counts, or what was done before where that is another. Then it is the same method as a new run with
that value, and another one than with another.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

from framework.errors import UserError
from framework.options import TrainerOptions
from framework.registry import GROUPS, JOINED_BY, lookup, option_fields, plain_fields

Flat = Mapping[str, Any]
Owner = tuple[str, str]  # of options: a group and the plugin's name
TRAINER: Owner = ("trainer", "")
# of options that came later and act by default: what is like a training without them
BEFORE: Mapping[Owner, dict[str, Any]] = {
    TRAINER: {
        **{"exposure": False, "depth_smoothness": 0.0, "binocular": 0.0},
        **{"pace_steps": 0, "pace_views": 0, "members": 1, "pseudo_factor": 1},
    },
    ("capacity", "evidence"): {"grow": 0.0},
    ("init", "stereo"): {"completion": 0.0},
    ("reg", "depth_density"): {"compensate": False},
}
PARTS = ("scene", "depth", "init")


def with_defaults(configs: Sequence[Flat]) -> list[Flat]:
    """The flat `configs`, each with the options that another one has of the same trainer or plugin.
    One that is not known, or that has no default, stays out."""
    keys: dict[Owner, set[str]] = defaultdict(set)
    for config in configs:
        for key in config:
            keys[_owner(key.partition(".")[0], config)].add(key)
    found: list[Flat] = []
    known: dict[Owner, Flat] = {}
    for config in configs:
        full = dict(config)
        for owner in (_owner(group, config) for group in ("trainer", *GROUPS, *PARTS)):
            for key in sorted(keys.get(owner, set()) - config.keys()):
                if owner not in known:  # plugins are looked for where one is asked about alone
                    known[owner] = _of(*owner)
                if key.partition(".")[2] in known[owner]:
                    full[key] = known[owner][key.partition(".")[2]]
        found.append(full)
    return found


def _owner(group: str, config: Flat) -> Owner:
    return group, str(config.get(f"{group}.name"))


def _of(group: str, name: str) -> Flat:
    """Option -> default of the trainer or a plugin; of several that work together as `uar.p`. Empty
    where it is not known."""
    if group == "trainer":
        return _values(plain_fields(TrainerOptions)) | BEFORE[TRAINER]
    found: dict[str, Any] = {}
    names = name.split(JOINED_BY)
    for own in names:
        try:
            cls = lookup(group, own)
        except UserError:
            return {}
        fields = option_fields(cls) if group in GROUPS else plain_fields(cls)
        prefix = f"{own}." if len(names) > 1 else ""
        own_values = _values(fields) | BEFORE.get((group, own), {})
        found |= {f"{prefix}{key}": value for key, value in own_values.items()}
    return found


def _values(fields: Sequence[tuple[str, Any, Any]]) -> dict[str, Any]:
    """Option -> default, as a composed configuration has it: 1 of a float is 1.0."""
    found: dict[str, Any] = {}
    for key, kind, field in fields:
        value = field.default
        if kind is float and type(value) is int:
            value = float(value)
        if value is not dataclasses.MISSING:
            found[key] = value
    return found
