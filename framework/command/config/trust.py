"""What a configuration may ask of Hydra: data, never code.

Hydra instantiates classes named in `hydra.callbacks`, `hydra.launcher` and `hydra.sweeper`, its log
configurations may call any function, a `pkg://` search path imports a package, a flag unpickles a
file, `hydra.job.env_set` and `oc.env` reach the environment. An experiment or a command line from a
stranger could use any of them. So the command line is read before Hydra composes anything, and
Hydra's part of the composed configuration before Hydra obeys it: what is not allowed here must be
as `conf/config.yaml` has it.

The output folders (`hydra.run.dir`, `hydra.sweep.dir`, `.subdir`) are the user's own choice: on the
command line, not in a file.
"""

from __future__ import annotations

import functools
import math
import os
import re
import sys
import urllib.parse
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from hydra import initialize_config_dir
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from framework.command.complaints import composing
from framework.command.config.schema import CONF_DIR, GROUPS, OBJECT_GROUPS, SWEEPS_DIR
from framework.command.launchers.check import check_launcher
from framework.command.program import program
from framework.errors import UserError, printable_line, require
from framework.files import limits
from framework.files.documents import check_yaml

FREE = ("mode", "overrides", "runtime", "verbose", "help", "hydra_help", "defaults", "env")
FOLDERS = ("run.dir", "sweep.dir", "sweep.subdir")
REFUSED_FLAGS = {
    "experimental_rerun": "a pickle can run code; give the run's overrides instead",
    "config_path": "use hydra.searchpath=[file://DIR] for configurations of your own",
    "config_name": "use hydra.searchpath=[file://DIR] and experiment=NAME of DIR/experiment",
    "config_dir": "use hydra.searchpath=[file://DIR]",
}
OF_GRAMMAR = set("'\"[]{}(),\\$")  # signs that mean something in the value of an override
NAMES = ("study", "metrics.lpips_weights", "scene.images", "scene.file")  # values that are names
NO_NAME = re.compile(r"[0-9+\-._e]+|true|false|[+-]?(inf|nan)", re.ASCII | re.I)  # a value of those
NO_WORDS = "#&;<>!~^`"  # of ASCII, what it reads only in quotation marks
QUIET = {"version": 1, "root": None, "disable_existing_loggers": False}  # hydra/*_logging=none


def check_command(flags: Any) -> None:
    """Raise UserError for a command line that is not allowed, as typed or as composed.

    flags: what Hydra's argument parser made of it. Nothing that it names is run.
    """
    for name, fix in REFUSED_FLAGS.items():
        if getattr(flags, name) is not None:
            raise UserError(f"--{name.replace('_', '-')}: expected no such flag, got one; {fix}")
    overrides = parsed(flags.overrides)
    check_deleted(overrides)
    _check_choices(overrides)
    folders = [CONF_DIR, SWEEPS_DIR, *_search_path(overrides)]
    for folder in folders:
        check_config_files(folder)
    with initialize_config_dir(version_base="1.3", config_dir=str(CONF_DIR)):
        loader = GlobalHydra.instance().config_loader()
        with composing():
            composed = loader.load_configuration(
                "config", flags.overrides, run_mode=RunMode.MULTIRUN, validate_sweep_overrides=False
            )
    check_composed(composed)
    params = composed.hydra.sweeper.params or {}
    check_run_count(overrides, params)
    multirun = flags.multirun or composed.hydra.mode is RunMode.MULTIRUN
    check_method(overrides, params if multirun else ())


def _check_choices(overrides: Sequence[Override]) -> None:
    """A choice is a name: Hydra would look up what `${...}` names, or fail in words of its own."""
    for override in overrides:
        if override.key_or_group in GROUPS and "${" in str(override.input_line):
            if "oc.env" in str(override.input_line):
                refuse_environment()
            raise UserError(
                f"{override.key_or_group}: expected a choice, got {override.input_line!r:.120};"
                " write its name"
            )


def parsed(lines: Sequence[str]) -> list[Override]:
    """The overrides as Hydra's grammar reads them. Raises UserError, or one of Hydra's, for a line
    that it cannot read, or would read for minutes."""
    for line in lines:
        require(
            len(line) <= limits.TEXT_LENGTH,
            f"command line: expected words of at most {limits.TEXT_LENGTH:,} characters, got"
            f" {len(line):,} in {line[:60]!r} ...; write them into an experiment's file",
        )
    try:
        overrides = OverridesParser.create().parse_overrides(list(lines))
    except (ValueError, RecursionError) as error:  # an integer of thousands of digits, for instance
        raise UserError(
            f"command line: expected values of a usual length, got {_longest(lines)!r}"
            f" ({printable_line(str(error))[:120]}); write KEY=VALUE"
        ) from error
    for override in overrides:
        require(
            override.key_or_group != "",
            f"command line: cannot read {str(override.input_line)[:100]!r}; write KEY=VALUE",
        )
    return overrides


def _longest(lines: Sequence[str]) -> str:
    line = max(lines, key=len)
    return line if len(line) <= 60 else f"{line[:60]} ..."


def check_composed(config: DictConfig) -> None:
    """Raise UserError unless Hydra's part of a composed configuration is allowed."""
    asked: Any = OmegaConf.to_container(config.hydra, resolve=False)
    own = _own()
    job = {key: asked["job"][key] for key in ("chdir", "env_set", "env_copy")}
    _expect("job", job, {"chdir": False, "env_set": {}, "env_copy": []})
    _expect("callbacks", asked["callbacks"], own["callbacks"])
    _expect("output_subdir", asked["output_subdir"], ".hydra")
    for logging in ("hydra_logging", "job_logging"):
        _expect(logging, asked[logging], QUIET)
    _check_folders(config, own)
    _check_search_path(asked["searchpath"])
    check_launcher(asked["launcher"], asked["overrides"]["hydra"])
    _check_sweeper(asked["sweeper"])
    known = {*FREE, "job", "callbacks", "output_subdir", "hydra_logging", "job_logging"}
    known |= {"run", "sweep", "searchpath", "launcher", "sweeper"}
    for key in asked:
        require(key in known, f"hydra.{key}: expected no such key, got one; remove it")


def quoted(argument: str) -> str:
    """`scene.path=my phötos` as `scene.path='my phötos'`: a value with letters that Hydra's grammar
    does not know is a text, unless it has signs of a list, a sweep or a quotation of its own. So is
    one that names a file, a folder or a study: `2024_05_12` is no number there."""
    key, equals, value = argument.partition("=")
    named = key.lstrip("+") in NAMES or key.endswith(".path")
    strange = any(not sign.isascii() or sign in NO_WORDS for sign in value)
    strange = strange or (named and NO_NAME.fullmatch(value) is not None)
    return f"{key}='{value}'" if equals and strange and not set(value) & OF_GRAMMAR else argument


def check_run_count(overrides: Sequence[Override], params: Mapping[Any, Any]) -> None:
    """Raise UserError when the command asks for more than `limits.RUNS` runs, without listing
    them. params: `hydra.sweeper.params`, which the overrides of the same keys replace."""
    swept = parsed([f"{key!s}={value}" for key, value in params.items()])
    lengths = {override.get_key_element(): _length(override) for override in [*swept, *overrides]}
    count = math.prod(lengths.values())
    require(
        count <= limits.RUNS,
        f"multirun: expected at most {limits.RUNS:,} runs, got {count:,}; sweep fewer values",
    )


def check_method(overrides: Sequence[Override], swept: Iterable[Any]) -> None:
    """Raise UserError for a method both of whose choices are replaced without a word: by others on
    the command line, or by those that a sweep has for each of its runs (swept). Where one of them
    is replaced, tell it."""
    given = {override.get_key_element(): override.input_line for override in overrides}
    if "method" in given and {"augment", "reg"} <= {*given, *swept}:
        raise UserError(
            f"{given['method']}: expected no method where augment and reg are chosen by themselves,"
            " here or by a sweep, got one, which would change nothing; leave it out, or give"
            " augment=NAME and reg=NAME in its place"
        )
    for group in ("augment", "reg"):
        if "method" in given and group in given:
            method, choice = given["method"], given[group]
            told = f"note: {choice} takes the place of what {method} has as {group}"
            print(told, file=sys.stderr)  # what --cfg prints is data


def check_deleted(overrides: Iterable[Override]) -> None:
    """Raise UserError for `~reg`: no part of a configuration can be done without."""
    for override in overrides:
        group = override.key_or_group
        if override.is_delete() and group in OBJECT_GROUPS:
            raise UserError(
                f"~{group}: expected a choice of {group}, got none; write {group}=NAME,"
                f" {program()} --help tells which"
            )


def check_config_files(folder: Path) -> None:
    """Raise UserError unless the YAML files of `folder` are small, few and flat.

    No aliases: nine lines of them can stand for a billion values.
    """
    for file in _yaml_files(folder):
        check_yaml(file)


def refuse_environment(*_: Any) -> Any:
    """Takes the place of OmegaConf's `oc.env`: records and reports are published, secrets not."""
    raise UserError(
        "${oc.env:...}: expected a value, got the environment, which a configuration may not read;"
        " write the value, or give it on the command line as KEY=$VARIABLE"
    )


def _yaml_files(folder: Path) -> list[Path]:
    """Those below the folder, through links as Hydra finds them, sorted; listed no further than
    the limits go: the folder may be the whole disk."""
    found: list[Path] = []
    entries = 0
    for here, folders, names in os.walk(folder, followlinks=True):
        entries += len(folders) + len(names)
        found += [Path(here, name) for name in names if name.endswith(".yaml")]
        for count, most, what in (
            (len(found), limits.CONFIG_FILES, ".yaml files"),
            (entries, limits.CONFIG_ENTRIES, "files and folders"),
        ):
            require(
                count <= most,
                f"{folder}: expected at most {most} {what}, got {count} or more; give the folder"
                " that holds the configurations alone",
            )
    return sorted(found)


def _search_path(overrides: Iterable[Override]) -> list[Path]:
    """The folders that the command line adds, all checked."""
    given = [o.value() for o in overrides if o.key_or_group == "hydra.searchpath"]
    return [folder for value in given for folder in _check_search_path(value)]


def _check_search_path(value: Any) -> list[Path]:
    folders = []
    for entry in value if isinstance(value, list) else [value]:
        text = str(entry)
        require(
            text.startswith("file://"),
            f"hydra.searchpath: expected folders as [file://DIR], got {text[:100]!r}; a package"
            " would be imported, which runs its code",
        )
        folders.append(Path(urllib.parse.unquote(text.removeprefix("file://"))))
    return folders


@functools.cache
def _own() -> dict[str, Any]:
    """Hydra's part of `conf/config.yaml`."""
    own: Any = OmegaConf.to_container(OmegaConf.load(CONF_DIR / "config.yaml"), resolve=False)
    return dict(own["hydra"])


def _expect(key: str, got: Any, expected: Any) -> None:
    require(
        got == expected,
        f"hydra.{key}: expected {expected}, as this project sets it, got {str(got)[:160]}; a"
        " configuration cannot run code or reach the environment, remove it",
    )


def _check_folders(config: DictConfig, own: Mapping[str, Any]) -> None:
    asked: Any = OmegaConf.to_container(config.hydra, resolve=False)
    typed = {line.partition("=")[0].lstrip("+") for line in asked["overrides"]["hydra"]}
    for key in FOLDERS:
        section, _, name = key.partition(".")
        require(
            f"hydra.{key}" in typed or asked[section][name] == own[section][name],
            f"hydra.{key}: expected it on the command line only, got {asked[section][name]!r} from"
            " a configuration file; remove it there",
        )


def _check_sweeper(got: Mapping[str, Any]) -> None:
    expected = {"_target_": _basic_sweeper(), "max_batch_size": None}
    _expect("sweeper", {k: v for k, v in got.items() if k != "params"}, expected)
    for key in got["params"] or {}:
        require(
            not str(key).lstrip("+~").startswith("hydra"),
            f"hydra.sweeper.params: expected options of the run, got {key!r}; give it on the"
            " command line",
        )


def _basic_sweeper() -> str:
    node: Any = ConfigStore.instance().load("hydra/sweeper/basic.yaml").node
    return str(node._target_)


def _length(override: Override) -> int:
    """The number of values an override sweeps over."""
    value = override.value()
    require(
        not isinstance(value, IntervalSweep),
        f"{override.input_line}: expected values to sweep over, as choice(0,0.5,1) or"
        " range(0,1.1,0.5), got an interval, which does not say which; list them",
    )
    if isinstance(value, ChoiceSweep):
        return len(value.list)
    if isinstance(value, RangeSweep):
        assert value.start is not None and value.stop is not None
        require(value.step != 0, f"{override.input_line}: expected a step other than 0; change it")
        require(
            all(map(math.isfinite, (value.start, value.stop, value.step))),
            f"{override.input_line}: expected finite bounds and step, got others; change them",
        )
        return max(0, math.ceil((value.stop - value.start) / value.step))
    return 1
