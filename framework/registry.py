"""name -> plugin class, with discovery and checked construction.

There are two kinds of groups. Plugins that act on a training (`GROUPS`) are built by `build` and
have framework keys besides their options. Parts of a run (`PARTS`: scene loaders, depth providers,
initializers, metrics) are built by `part` and join the table of the built-in ones.

Plugins are found in the `plugins/` folder and in installed packages with the entry point group
`fishersplat.plugins`. A folder of the user's plugins is added by `--plugins`. Launchers start new
processes, so `discover` is cheap to call again.
"""

import dataclasses
import functools
import importlib
import importlib.util
import math
import pkgutil
import re
import sys
import typing
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType, UnionType
from typing import Any, TypeVar

from framework.errors import UserError, nearest_hint, plugin_call, require
from framework.files.paths import ENTRY_POINTS, own_plugins

GROUPS = {"augment": "plugins.augment", "reg": "plugins.regularize", "capacity": "plugins.capacity"}
PARTS = {
    "scene": "plugins.scenes",
    "depth": "plugins.depth",
    "init": "plugins.initialize",
    "metric": "plugins.metrics",
}
SWEPT = "_sweep"  # ends the name of a recipe with the plane sweep in place of a network
OURS = ("framework", "plugins")  # packages of this project's classes
REQUIRED = {  # a class must override one of these methods
    "scene": ("load",),
    "depth": ("measure",),
    "init": ("build",),
    "metric": ("measure",),
    "augment": ("pseudo_views",),
    "reg": ("opacity_factors", "loss", "substeps", "gradient", "evaluated"),
    "capacity": ("update",),
}
FOLDER = Path(__file__).resolve().parent.parent / "plugins"
YAML_WORDS = ("true", "false", "null")  # which no command line can choose
FRAMEWORK_KEYS = {"weight": 1.0, "start": 0.0, "stop": 1.0}
MEANINGS = {
    "weight": "factor of its loss",
    "start": "share of the training before it acts",
    "stop": "share of the training until which it acts",
}
JOINABLE = ("reg", "capacity")  # several of these may work in one run, as `reg=[uar,depth_rank]`
JOINED_BY = "+"  # their names are one choice: `uar+depth_rank`
OPTION_TYPES = (bool, int, float, str, type(None))
UNSET = "???"  # omegaconf's MISSING: a required option without a value
UNIONS = (typing.Union, UnionType)

BASES: dict[str, type] = {}  # of every group, by `framework.plugin`, which stands above
_classes: dict[str, dict[str, type]] = {group: {} for group in GROUPS}
C = TypeVar("C", bound=type)
Row = tuple[str, Any, Any]  # (option name, type, dataclasses.field)


def register(group: str, name: str) -> Callable[[C], C]:
    """Class decorator: make a frozen dataclass selectable as `group=name` (a metric as
    `metrics.also=name`)."""

    def add(cls: C) -> C:
        groups = [*GROUPS, *PARTS]
        require(group in groups, f"register: unknown group {group}; {nearest_hint(group, groups)}")
        _check_class(group, name, cls)
        classes = _table(group)
        other = classes.get(name)
        places = [f"{one.__module__}.{one.__qualname__}" for one in (other or cls, cls)]
        require(
            places[0] == places[1],
            f"{group}={name}: two plugins claim this name, {' and '.join(places)}; rename one",
        )
        cls.name, cls.group = name, group  # type: ignore[attr-defined]
        classes[name] = cls
        return cls

    return add


def _table(group: str) -> dict[str, type]:
    """The table of a group, of a part of a run in the room that uses it: name -> class."""
    from framework.backends import RASTERIZERS
    from framework.depth import PROVIDERS
    from framework.initialize import INITIALIZERS
    from framework.metrics.values import MEASURES
    from framework.scenes import LOADERS

    parts = {"scene": LOADERS, "depth": PROVIDERS, "init": INITIALIZERS, "metric": MEASURES}
    return {**_classes, **parts, "rasterizer": RASTERIZERS}[group]


def table(group: str) -> dict[str, type]:
    """The table of a group, built-in classes and plugins: name -> class."""
    discover()
    return _table(group)


def _check_class(group: str, name: str, cls: type) -> None:
    """Raise UserError unless `cls` is a frozen dataclass whose fields are options."""
    where = f"{group}={name} ({cls.__module__}.{cls.__qualname__})"
    dataclass_params: Any = vars(cls).get("__dataclass_params__")
    require(
        dataclass_params is not None and dataclass_params.frozen,
        f"{where}: expected a frozen dataclass, got another class; put @dataclass(frozen=True)"
        " between @register and the class",
    )
    taken = (*(FRAMEWORK_KEYS if group in GROUPS else ()), "name", "group")
    for option in dataclasses.fields(cls):
        require(
            option.name not in taken,
            f"{where}: expected options beside {', '.join(taken)}, which every plugin of this group"
            f" has, got a field '{option.name}'; rename it, or set it in `defaults`",
        )
    defaults = getattr(cls, "defaults", {}) if group in GROUPS else {}
    require(
        isinstance(defaults, Mapping)
        and all(key in FRAMEWORK_KEYS and _is_finite(value) for key, value in defaults.items()),
        f"{where}: `defaults` must be a dict of finite numbers for {', '.join(FRAMEWORK_KEYS)}, got"
        f" {defaults!r:.80}; a default of an option stands behind its field",
    )
    typed = {*cls.__annotations__, "defaults", "name", "group"}  # the last two: registered twice
    for base in cls.__mro__:  # what a contract declares for the class, as `drops`
        typed |= set(base.__annotations__) if base.__module__ == "framework.plugin" else set()
    for key, value in vars(cls).items():
        require(
            key.startswith("_") or key in typed or not isinstance(value, OPTION_TYPES),
            f"{where}: expected options with a type, got '{key} = {value!r:.40}'; write"
            f" '{key}: {type(value).__name__} = {value!r:.40}'",
        )
    _check_contract(group, name, cls, where)


def _is_finite(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _check_contract(group: str, name: str, cls: type, where: str) -> None:
    """Raise UserError unless `cls` can be this part of a run under this name."""
    require(
        re.fullmatch(r"[a-z][a-z0-9_]*", name) is not None and name not in YAML_WORDS,
        f"{where}: expected a name of lower-case letters, digits and _, got {name!r:.40}; rename"
        " it",
    )
    from framework.metrics.values import RESERVED

    require(
        group != "metric" or name not in RESERVED,
        f"{where}: expected another name than those of every run's table, got {name}; rename it",
    )
    base = BASES.get(group)
    require(
        base is not None and issubclass(cls, base),
        f"{where}: expected a class derived from framework.plugin."
        f"{getattr(base, '__name__', group)}, got another; derive it",
    )
    hooks = REQUIRED[group]
    needed = f"the method `{hooks[0]}`" if len(hooks) == 1 else f"one of {', '.join(hooks)}"
    require(
        getattr(cls, "idle", False)
        or any(getattr(cls, hook) is not getattr(base, hook) for hook in hooks),
        f"{where}: expected {needed}, got none; add it",
    )
    for _, _, option in plain_fields(cls) if group == "metric" else ():
        require(
            option.default is not dataclasses.MISSING,
            f"{where}: expected a default for '{option.name}', got none; a metric is built from its"
            " defaults",
        )


def discover() -> None:
    """Import every plugin module, so that all of them are registered."""
    _import_packages()
    for place, file in own_plugins():
        name = f"own_plugins.{place.removesuffix('.py').replace('/', '.')}"
        if name not in sys.modules and not file.name.startswith("_"):
            with plugin_call(f"{file}: importing it"):
                _import_file(name, file)
    for point in _installed():
        source = f"entry point {point.name} = {point.value}: importing it"
        with plugin_call(source, "fix or uninstall that package"):
            point.load()


@functools.cache
def _import_packages() -> None:
    """Import the modules of the folder `plugins/`, once per process."""
    for package_name in (*GROUPS.values(), *PARTS.values()):
        package = importlib.import_module(package_name)
        _check_place(package)
        for module in pkgutil.iter_modules(package.__path__):
            name = f"{package_name}.{module.name}"
            with plugin_call(f"{name}: importing it"):
                importlib.import_module(name)


def _import_file(name: str, file: Path) -> None:
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise UserError(f"{file}: expected a Python file, got another; rename it")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def _check_place(package: ModuleType) -> None:
    """Another package called `plugins` may come before ours on the path; it is not used."""
    place = Path(str(package.__file__)).resolve()
    require(
        place.is_relative_to(FOLDER),
        f"{package.__name__}: expected the plugins in {FOLDER}, got {place}; take the other package"
        " called 'plugins' off PYTHONPATH",
    )


@functools.cache
def _installed() -> tuple[EntryPoint, ...]:
    """The entry points of installed packages; looking for them takes milliseconds, so once."""
    return tuple(entry_points(group=ENTRY_POINTS))


def lookup(group: str, name: str) -> type:
    """The class behind `group=name`; an unknown name lists the options and the nearest."""
    classes = table(group)
    require(name in classes, f"{group}={name}: unknown {group}; {nearest_hint(name, classes)}")
    return classes[name]


def option_fields(cls: type) -> list[Row]:
    """Every option, framework keys first."""
    overrides = getattr(cls, "defaults", {})
    rows: list[Row] = [
        (key, float, field(default=float(overrides.get(key, default))))
        for key, default in FRAMEWORK_KEYS.items()
    ]
    return rows + plain_fields(cls)


def plain_fields(cls: type) -> list[Row]:
    """Every field of an options class. UserError for a type that the command line cannot give."""
    rows: list[Row] = []
    with plugin_call(f"{cls.__module__}.{cls.__name__}: its options' types", "import that name"):
        hints = typing.get_type_hints(cls)
    for option in dataclasses.fields(cls):
        hint = hints[option.name]
        kinds = typing.get_args(hint) if typing.get_origin(hint) in UNIONS else (hint,)
        require(
            all(kind in OPTION_TYPES for kind in kinds),
            f"{cls.__module__}: expected the option '{option.name}' of {cls.__name__} to be a bool,"
            f" int, float or str, got {hint}; make a choice a str and check it in"
            " __post_init__",
        )
        rows.append((option.name, hint, option))
    return rows


@dataclass(frozen=True)
class ActivePlugin:
    """A plugin with its framework keys, active while start <= progress < stop."""

    plugin: Any
    weight: float = 1.0
    start: float = 0.0
    stop: float = 1.0

    def active(self, progress: float) -> bool:
        return self.start <= progress < self.stop


def parts_of(group: str, name: str) -> list[str]:
    """The names in a choice of several plugins, `name` if it is one. Raises UserError."""
    names = name.split(JOINED_BY)
    if len(names) > 1:
        choice = f"{group}=[{','.join(names)}]"
        require(
            group in JOINABLE,
            f"{choice}: expected one {group}, got {len(names)}; a run may have several of"
            f" {' and '.join(JOINABLE)} alone",
        )
        require(
            all(names) and len(set(names)) == len(names),
            f"{choice}: expected different names, got {', '.join(map(repr, names))}; use each once",
        )
    return names


def part(group: str, config: Mapping[str, Any]) -> Any:
    """The part of a run that `config` (key `name` + options) describes. Raises UserError."""
    name = str(config.get("name", ""))
    cls = lookup(group, name)
    return _constructed(f"{group}={name}", cls, _options(group, config, plain_fields(cls)))


def _options(group: str, config: Mapping[str, Any], fields: Iterable[Row]) -> dict[str, Any]:
    """The options in `config`. Raises UserError if one is unknown, or a required one missing."""
    chosen = f"{group}={config.get('name', '')}"
    options = {key: value for key, value in config.items() if key != "name"}
    defaults = {key: option.default for key, _, option in fields}
    for key in options:
        require(
            key in defaults,
            f"{group}.{key}: unknown option of {chosen}; {nearest_hint(key, defaults)}",
        )
    for key, default in defaults.items():
        require(
            options.get(key, default) not in (UNSET, dataclasses.MISSING),
            f"{group}.{key}: required by {chosen}, got nothing; add {group}.{key}=VALUE",
        )
    return options


def _constructed(where: str, cls: Any, options: Mapping[str, Any]) -> Any:
    """A plugin or part with these options. Raises UserError with its name."""
    with plugin_call(where, "correct its options, or fix __post_init__"):
        return cls(**options)


def build_all(group: str, config: Mapping[str, Any]) -> dict[str, ActivePlugin]:
    """Build the plugins of a group: {group: plugin}, or {"group.name": plugin, ...} of several.

    Raises:
        UserError: for an unknown plugin, option or value.
    """
    names = parts_of(group, str(config.get("name", "")))
    if len(names) == 1:
        return {group: build(group, config)}
    for key in config:
        require(
            key in (*names, "name"),
            f"{group}.{key}: unknown option of several plugins; write {group}.NAME.{key}",
        )
    return {f"{group}.{name}": build(group, config[name]) for name in names}


def build(group: str, config: Mapping[str, Any]) -> ActivePlugin:
    """Build the plugin that `config` (key `name` + options) describes. Raises UserError."""
    name = str(config.get("name", ""))
    cls: Any = lookup(group, name)
    fields = option_fields(cls)
    options = _options(group, config, fields)
    defaults = {key: option.default for key, _, option in fields if key in FRAMEWORK_KEYS}
    keys = {key: float(options.pop(key, default)) for key, default in defaults.items()}
    with plugin_call(f"{group}={name}: weighted"):
        weighted = cls.weighted()
    require(
        keys["weight"] == defaults["weight"] or weighted,
        f"{group}={name}: weight multiplies a loss, and {name} has none; drop {group}.weight, or"
        f" compare it with a variant that sets it, a file conf/{group}/VARIANT.yaml",
    )
    require(
        0 <= keys["weight"] < math.inf,
        f"{group}={name}: weight must be a finite number >= 0, got {keys['weight']}",
    )
    require(
        0 <= keys["start"] <= keys["stop"] <= 1,
        f"{group}={name}: expected 0 <= start <= stop <= 1 (shares of the training), got"
        f" start={keys['start']}, stop={keys['stop']}",
    )
    plugin = _constructed(f"{group}={name}", cls, options)
    with plugin_call(f"{group}={name}: check_span"):
        plugin.check_span(keys["start"], keys["stop"])
    return ActivePlugin(plugin, keys["weight"], keys["start"], keys["stop"])
