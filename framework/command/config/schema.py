"""The typed configuration: which groups there are, what each choice accepts, and its check.

Every choice of a group (a plugin or a built-in part) is a dataclass
whose typed fields are its options. From each one a Hydra structured-config node is made: the key
`name` and the options, so that Hydra refuses unknown keys and wrong types by itself. An option
without a default is MISSING ("???") until the user gives it. `conf/config.yaml` has the top level.

This module imports neither torch nor numba: `--help` and every configuration error stay instant.
"""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Iterable, Mapping
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, OmegaConf

import framework
from framework import registry
from framework.command.hydra_inside import JoinedChoices
from framework.errors import UserError, nearest_hint, require
from framework.metrics.values import measures
from framework.options import TrainerOptions
from framework.run import trackers

PACKAGE = Path(framework.__file__).resolve().parent
ROOT = PACKAGE.parent  # of the repository, or where packages are installed
# a wheel holds both folders inside the package, where no other package's can take their place
INSTALLED = (PACKAGE / "conf").is_dir()
CONF_DIR, SWEEPS_DIR = ((PACKAGE if INSTALLED else ROOT) / name for name in ("conf", "sweeps"))

# Groups that choose an object; `preset` (training conditions), `method` (an augmenter and a
# regularizer), `experiment` and `sweep` only bundle choices of these.
OBJECT_GROUPS = ("scene", "depth", "init", "augment", "reg", "capacity", "rasterizer")
GROUPS = (*OBJECT_GROUPS, "preset", "method", "experiment", "sweep")

Row = tuple[str, Any, Any]  # (option name, type, dataclasses.field)


SCALARS = {
    **{"seed": int, "study": str | None, "threads": int},
    **{"force": bool, "traceback": bool, "estimate": bool},
    "tracker": str | None,
}
MOST_THREADS = 1024
METRICS = {"lpips_weights": str | None, "also": str | None, "coadaptation": bool}


def tables() -> dict[str, dict[str, type]]:
    """group -> name -> options class, for the parts of a run that are chosen by a group."""
    from framework.rasterizers import RASTERIZERS

    chosen = {group: registry.parts(group) for group in registry.PARTS if group in OBJECT_GROUPS}
    return chosen | {"rasterizer": RASTERIZERS}


def choices(group: str) -> list[str]:
    """The names that `group=` accepts without the YAML variants, sorted."""
    return registry.names(group) if group in registry.GROUPS else sorted(tables()[group])


def rows(group: str, name: str) -> list[Row]:
    """The options of `group=name`; of several plugins none, as each has its own. Raises UserError
    for an unknown name."""
    if len(registry.parts_of(group, name)) > 1:
        return []
    if group in registry.GROUPS:
        return registry.option_fields(registry.lookup(group, name))
    table = tables()[group]
    require(name in table, f"{group}={name}: unknown {group}; {nearest_hint(name, table)}")
    return registry.plain_fields(table[name])


def class_rows(cls: type) -> list[Row]:
    """The options of a plain options dataclass, in the order of declaration."""
    hints = typing.get_type_hints(cls)
    return [(f.name, hints[f.name], f) for f in dataclasses.fields(cls)]


def node(title: str, options: Iterable[Row], **fixed: str) -> type:
    """A structured-config class with the keys `fixed` and then `options`.

    It is a copy and not the options class itself: OmegaConf makes frozen dataclasses read-only and
    runs no `__post_init__`, so the checks stay with the real class (see `check`).
    """
    keys: list[Row] = [(key, str, field(default=value)) for key, value in fixed.items()]
    return make_dataclass(title, keys + [(n, kind, _with_default(f)) for n, kind, f in options])


def _with_default(option: Any) -> Any:
    if option.default_factory is not dataclasses.MISSING:
        return field(default_factory=option.default_factory)
    required = option.default is dataclasses.MISSING
    return field(default=MISSING if required else option.default)


def _top_level() -> type:
    """The schema of the whole configuration; the values are in conf/config.yaml."""
    sections = {
        "trainer": node("trainer", class_rows(TrainerOptions)),
        "metrics": node("metrics", [_required(*item) for item in METRICS.items()]),
    }
    fields = [_required(*item) for item in SCALARS.items()]
    fields += [(key, kind, field(default_factory=kind)) for key, kind in sections.items()]
    return make_dataclass("top level", fields + [_required(group, Any) for group in OBJECT_GROUPS])


def _required(key: str, kind: Any) -> Row:
    return (key, kind, field(default=MISSING))


def register_config() -> None:
    """Put the schema, every choice of every group and the named sweeps into Hydra's ConfigStore.

    Safe to call again: launchers start processes where nothing is registered yet.
    """
    store = ConfigStore.instance()
    store.store(name="schema", node=_top_level())
    for group in OBJECT_GROUPS:
        for name in choices(group):
            title = f"{group}={name}"
            store.store(group=group, name=name, node=node(title, rows(group, name), name=name))
    for group in registry.JOINABLE:
        store.repo[group] = JoinedChoices(group, store.repo[group])
    # `sweeps/` stands beside `conf/`, where a config group cannot be: each file becomes a node.
    for path in sorted(SWEEPS_DIR.glob("*.yaml")):
        store.store(group="sweep", name=path.stem, package="_global_", node=OmegaConf.load(path))


def check(config: Mapping[str, Any]) -> None:
    """Raise UserError unless `config` (plain, resolved) describes a run that can start.

    Every group needs a choice, every required option a value, and no key may be unknown (Hydra lets
    `+key=value` through); then the chosen classes check their own options. Reads no scene.
    """
    _known_keys("", config, [*SCALARS, "trainer", "metrics", *OBJECT_GROUPS])
    _known_keys("trainer.", config["trainer"], [row[0] for row in class_rows(TrainerOptions)])
    _known_keys("metrics.", config["metrics"], METRICS)
    _check_integers("", config)
    for group in OBJECT_GROUPS:
        _check_choice(group, config[group])
    for group in registry.GROUPS:
        registry.build(group, config[group])
    for group, table in tables().items():
        options = dict(config[group])
        table[options.pop("name")](**options)
    registry.parts("metric")
    measures(config["metrics"].get("also"))
    TrainerOptions(**config["trainer"])
    _check_scalars(config["seed"], config["threads"], config["study"])
    trackers.ready(config.get("tracker"))


def _check_integers(prefix: str, options: Mapping[str, Any]) -> None:
    """Raise UserError for an integer that libraries cannot take."""
    for key, value in options.items():
        if isinstance(value, Mapping):
            _check_integers(f"{prefix}{key}.", value)
        require(
            type(value) is not int or abs(value) < 2**63,
            f"{prefix}{key}: expected an integer below 2^63, got {value}; choose another",
        )


def _check_scalars(seed: int, threads: int, study: str | None) -> None:
    require(seed >= 0, f"seed: expected an integer >= 0, got {seed}; choose another")
    require(threads >= 0, f"threads: expected an integer >= 0, got {threads}; 0 uses all cores")
    require(
        threads <= MOST_THREADS,
        f"threads: expected an integer of at most {MOST_THREADS}, got {threads}; 0 uses all cores",
    )
    require(
        study is None or re.fullmatch(r"\w[\w.-]*(/\w[\w.-]*)*", study) is not None,
        f"study: expected a folder name of letters, digits, _ . and -, got {study!r}; rename it",
    )


def _check_choice(group: str, options: Any) -> None:
    """A group needs a name (an empty choice must not be half-configured) and no missing option."""
    if not isinstance(options, Mapping) or "name" not in options:
        raise UserError(
            f"{group}: expected a choice, got none; add {group}=NAME, available:"
            f" {', '.join(choices(group.partition('.')[0]))}"
        )
    title = f"{group}={options['name']}"
    parts = registry.parts_of(group, str(options["name"]))
    if len(parts) > 1:
        _known_keys(f"{group}.", [key for key in options if key != "name"], parts, title)
        for part in parts:
            _check_choice(f"{group}.{part}", options.get(part))
        return
    kind = group.partition(".")[0]
    known = [row[0] for row in rows(kind, options["name"])]
    _known_keys(f"{group}.", {k: v for k, v in options.items() if k != "name"}, known, title)
    for key, value in options.items():
        require(
            value != MISSING,
            f"{group}.{key}: required by {title}, got nothing; add {group}.{key}=VALUE",
        )


def _known_keys(prefix: str, given: Iterable[str], known: Iterable[str], owner: str = "") -> None:
    options = list(known)
    place = f" of {owner}" if owner else ""
    for key in given:
        require(
            key in options,
            f"{prefix}{key}: unknown option{place}; {nearest_hint(key, options)}",
        )
