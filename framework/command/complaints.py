"""Exceptions of Hydra and OmegaConf as one line in the style of `UserError`.

Both libraries report bad input in several lines and in internal terms ("not in struct"). The user
gets: where, what was expected, what came, how to fix it.
"""

from __future__ import annotations

import dataclasses
import os
import re
import shlex
import typing
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    OmegaConfBaseException,
    ValidationError,
)

from framework.command.config.check import hint
from framework.command.config.schema import CONF_DIR, OBJECT_GROUPS
from framework.command.launchers.supported import LAUNCHERS, missing_extra, package_of
from framework.errors import UserError, mendable, nearest_hint, os_line, printable_line
from framework.files.paths import OWN_VARIABLE
from framework.files.program import program
from framework.registry import SWEPT

USER_ERRORS = (UserError, HydraException, OmegaConfBaseException)
SEVERAL = re.compile(  # `seed=0,1`, and `seed=range(3)` or another word of the grammar
    r"Ambiguous value for argument '(.*?)'\s+1\. To use it as a list"
    r"|Sweep parameters '(.*)' requires --multirun",
    re.S,
)
EACH = "add -m to make a run of each"
INFORM = ("--help", "-h", "--cfg", "-c")
NOT_THERE = re.compile(r"Could not override '(\w+)\.(\w+)'")  # Hydra's, of a group of several
KINDS = {
    **{int: "an integer", float: "a number", bool: "true or false", str: "a text"},
    type(None): "null",
}


@contextmanager
def composing() -> Iterator[None]:
    """Turn Python's errors inside Hydra into UserError: a number of too many digits, a choice that
    is no name."""
    try:
        yield
    except USER_ERRORS:
        raise
    except (ValueError, ArithmeticError, RecursionError) as error:
        raise UserError(
            f"command line: expected options of the configuration, got what Hydra refuses"
            f" ({printable_line(str(error))[:160]}); --help lists the options"
        ) from error


def one_line(error: BaseException) -> str:
    """The message of a user's error in one line, from its most specific cause."""
    chain = _causes(error)
    for cause in chain:
        if isinstance(cause, UserError):
            return printable_line(str(cause))
    for cause in chain:
        text = _reworded(cause)
        if text is not None:
            return printable_line(text)
    texts = [printable_line(str(cause)) for cause in (*chain[::-1], *chain)]
    return next(filter(None, texts), f"refused without a reason ({type(chain[0]).__name__})")


def with_variant(message: str, words: Sequence[str]) -> str:
    """Add to `message` what could be typed instead of `words`.

    With -m if the message advises it. For a missing depth network the recipe's variant NAME_sweep.
    """
    if message.endswith(EACH) and any(word in INFORM for word in words):
        return message.replace(EACH, "name one, or several that work together, as reg=[a,b]")
    if message.endswith(EACH):
        return f"{message}: {program()} {shlex.join(words)} -m"
    if not message.startswith(("depth=", "depth.")):
        return message
    chosen = [word.lstrip("+").removeprefix("method=") for word in words if "method=" in word]
    names = [f"{name}{SWEPT}" for word in chosen for name in word.split(",")]
    there = [f"method={name}" for name in names if (CONF_DIR / "method" / f"{name}.yaml").exists()]
    if not there:
        return message
    return f"{message}; or take the plane sweep instead of a network: {', '.join(there)}"


def _causes(error: BaseException) -> list[BaseException]:
    """Return `error` and its causes, the original first.

    OmegaConf hides causes (`from None`), so contexts are followed too. With OC_CAUSE=1 or under a
    debugger it links causes into a cycle, hence the check for repetition.
    """
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None and cause not in chain:
        chain.append(cause)
        cause = cause.__cause__ or cause.__context__
    return chain[::-1]


def _reworded(error: BaseException) -> str | None:
    """Reword an exception of Hydra, OmegaConf or the system; None for others."""
    if isinstance(error, OSError) and mendable(error):
        return os_line(error)
    if isinstance(error, MissingConfigException):
        return _missing_choice(error)
    if isinstance(error, OverrideParseException):
        return (
            f"command line: cannot read {error.override!r}; write KEY=VALUE and put quotes around"
            " a value with spaces or special characters: \"key='a b'\""
        )
    if isinstance(error, HydraException) and "INTERVAL_SWEEP" in str(error):
        return (
            "multirun: expected a list of values, such as choice(0,0.5,1) or range(0,1.1,0.5), got"
            " an interval; list the values"
        )
    if isinstance(error, HydraException) and (several := SEVERAL.search(str(error))):
        word = several[1] or several[2]
        key, _, values = word.partition("=")
        return f"{key}: expected one value, got several ({values}); {EACH}"
    if isinstance(error, HydraException) and (missed := NOT_THERE.search(str(error))):
        group, key = missed.groups()
        return (
            f"{group}.{key}: unknown option of {group}; with several plugins the options are"
            f" {group}.NAME.OPTION, --help with these words lists them"
        )
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return _unknown_key(error)
    if isinstance(error, ValidationError) and error.full_key:
        return f"{error.full_key}: expected {_expected(error)}, got {error.value!r}"
    return None


def _expected(error: OmegaConfBaseException) -> str:
    """The declared type of the option with a wrong value, in words."""
    types = {option.name: option.type for option in _fields(error.object_type)}
    declared = types.get(str(error.key), "another type")
    return " or ".join(map(_kind, typing.get_args(declared) or (declared,)))


def _kind(declared: Any) -> str:
    if isinstance(declared, type):
        return KINDS.get(declared, f"the options of {declared.__name__}")
    return str(declared)


def _fields(kind: Any) -> list[Any]:
    """The fields of a structured-config class; none for anything else."""
    is_schema = isinstance(kind, type) and dataclasses.is_dataclass(kind)
    return list(dataclasses.fields(kind)) if is_schema else []


def _missing_choice(error: MissingConfigException) -> str | None:
    if not error.missing_cfg_file or error.options is None:
        return None
    group, _, name = error.missing_cfg_file.rpartition("/")
    extra = missing_extra(name) if group == "hydra/launcher" else None
    if extra is not None:
        return (
            f"{group}={name}: expected {package_of(name)} to be installed, found it missing; pip"
            f" install 'fishersplat[{extra}]'"
        )
    options = {*error.options, *(LAUNCHERS if group == "hydra/launcher" else ())}
    folder = os.environ.get(OWN_VARIABLE)
    plugins = f"--plugins {folder} was searched too" if folder else "--plugins DIR adds your own"
    folders = f"; {plugins}" if group in OBJECT_GROUPS else ""
    return f"{group}={name}: unknown {group}; {nearest_hint(name, options)}{folders}"


def _unknown_key(error: OmegaConfBaseException) -> str | None:
    options = [f.name for f in _fields(error.object_type) if f.name != "name"]
    if not error.full_key or not options or error.object_type is None:
        return None
    parent, _, key = str(error.full_key).rpartition(".")
    place = f" of {error.object_type.__name__}" if parent else ""
    photos = "; for a folder of photos add scene=photos" if error.full_key == "scene.path" else ""
    return f"{error.full_key}: unknown option{place}; {hint(parent, key, options)}{photos}"
