"""The typed configuration: the groups, and the options of each choice.

Every choice of a group (a plugin or a built-in part) is a dataclass whose typed fields are its
options. Each becomes a Hydra structured-config node with the key `name` and the options, so Hydra
refuses unknown keys and wrong types. An option without a default is MISSING ("???") until the user
gives it. `conf/config.yaml` has the top level.

`framework.command.config.check` checks a composed configuration. This module imports neither torch
nor numba, so `--help` and errors of the configuration are quick.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import field, make_dataclass
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, OmegaConf

import framework
from framework import registry
from framework.command.hydra_inside import JoinedChoices
from framework.options import TrainerOptions
from framework.records import record_check
from framework.registry import Row

PACKAGE = Path(framework.__file__).resolve().parent
ROOT = PACKAGE.parent  # of the repository, or where packages are installed
# a wheel holds both folders inside the package, where no other package's can take their place
INSTALLED = (PACKAGE / "conf").is_dir()
CONF_DIR, SWEEPS_DIR = ((PACKAGE if INSTALLED else ROOT) / name for name in ("conf", "sweeps"))

# Groups that choose an object; `preset` (training conditions), `method` (an augmenter and a
# regularizer), `experiment` and `sweep` only bundle choices of these.
OBJECT_GROUPS = record_check.GROUPS
GROUPS = (*OBJECT_GROUPS, "preset", "method", "experiment", "sweep")

SCALARS = {
    **{"seed": int, "study": str | None, "threads": int},
    **{"force": bool, "traceback": bool, "estimate": bool | str},
    "tracker": str | None,
}
METRICS = {
    **{"lpips_weights": str | None, "lpips_both": bool, "views": int},
    **{"also": str | None, "coadaptation": bool},
}

# the store's content, and the classes whose nodes it has; None before the first registration
_registered: tuple[dict[str, Any], dict[str, dict[str, type]]] | None = None


def choices(group: str) -> list[str]:
    """The names that `group=` accepts without the YAML variants, sorted."""
    return sorted(registry.table(group))


def rows(group: str, name: str) -> list[Row]:
    """The options of `group=name`; of several plugins none, as each has its own.

    Raises:
        UserError: for an unknown name.
    """
    if len(registry.parts_of(group, name)) > 1:
        return []
    cls = registry.lookup(group, name)
    return registry.option_fields(cls) if group in registry.GROUPS else registry.plain_fields(cls)


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
        "trainer": node("trainer", registry.plain_fields(TrainerOptions)),
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
    global _registered
    store = ConfigStore.instance()
    classes = {group: dict(registry.table(group)) for group in OBJECT_GROUPS}
    if _registered is not None and _registered[0] is store.repo and _registered[1] == classes:
        return
    store.store(name="schema", node=_top_level())
    for group in OBJECT_GROUPS:
        for name in choices(group):
            title = f"{group}={name}"
            store.store(group=group, name=name, node=node(title, rows(group, name), name=name))
    for group in registry.JOINABLE:
        store.repo[group] = JoinedChoices(group, store.repo[group])
    # `sweeps/` is outside of `conf/`, where Hydra looks for groups: each file becomes a node
    for path in sorted(SWEEPS_DIR.glob("*.yaml")):
        store.store(group="sweep", name=path.stem, package="_global_", node=OmegaConf.load(path))
    _registered = store.repo, classes
