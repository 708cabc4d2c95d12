"""Hydra's and OmegaConf's exceptions as one line in the style of `UserError`.

Both libraries tell a bad input over several lines and in their own terms ("not in struct"); the
user gets: where, what was expected, what came, how to fix it.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    OmegaConfBaseException,
    ValidationError,
)

from framework.errors import UserError, nearest_hint

USER_ERRORS = (UserError, HydraException, OmegaConfBaseException)
KINDS = {int: "an integer", float: "a number", bool: "true or false", str: "a text"}


def one_line(error: BaseException) -> str:
    """The message of a user's error, without its newlines; the most specific cause speaks."""
    chain = list(_causes(error))
    for cause in chain:
        if isinstance(cause, UserError):
            return _flat(str(cause))
    for cause in chain:
        told = _told(cause)
        if told is not None:
            return _flat(told)
    return _flat(str(error)) or type(error).__name__


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """`error` and what caused it, the original first."""
    if error is not None:
        yield from _causes(error.__cause__)
        yield error


def _told(error: BaseException) -> str | None:
    """Our words for one exception of Hydra or OmegaConf; None if we have none."""
    if isinstance(error, MissingConfigException):
        return _missing_choice(error)
    if isinstance(error, OverrideParseException):
        return (
            f"command line: cannot read {error.override!r}; write KEY=VALUE and put quotes around"
            " a value with special characters: \"key='a b'\""
        )
    if isinstance(error, ConfigKeyError | ConfigAttributeError):
        return _unknown_key(error)
    if isinstance(error, ValidationError) and error.full_key:
        expected = KINDS.get(error.ref_type or object, error.ref_type_str or "another type")
        return f"{error.full_key}: expected {expected}, got {error.value!r}"
    return None


def _missing_choice(error: MissingConfigException) -> str | None:
    if not error.missing_cfg_file or error.options is None:
        return None
    group, _, name = error.missing_cfg_file.rpartition("/")
    return f"{group}={name}: unknown {group}; {nearest_hint(name, error.options)}"


def _unknown_key(error: OmegaConfBaseException) -> str | None:
    if not error.full_key or not dataclasses.is_dataclass(error.object_type):
        return None
    known = [f.name for f in dataclasses.fields(error.object_type)]
    parent, _, key = str(error.full_key).rpartition(".")
    place = f" of {error.object_type.__name__}" if parent else ""
    return f"{error.full_key}: unknown option{place}; {nearest_hint(key, known)}"


def _flat(text: str) -> str:
    return re.sub(r"\s*\n\s*", "; ", text.strip())
