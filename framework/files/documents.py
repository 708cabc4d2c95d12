"""Reads JSON and YAML from strangers as plain values within limits.

The values are mappings with strings as keys, lists, strings, numbers, booleans and null. Their size
is bounded by that of the file: there are no YAML aliases (nine lines of them are a billion values),
no tags, no deep nesting and no lone surrogates.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import yaml

from framework.errors import UserError, require
from framework.files.limits import CONFIG_BYTES, DEPTH, TEXT_LENGTH
from framework.files.opened import read_text

LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
LARGEST_INTEGER = 2**64


def read_json(path: Path, limit: int) -> Any:
    """The value of a JSON file of at most `limit` bytes.

    Raises:
        UserError: for any other content.
    """
    return json_value(path, read_text(path, limit))


def json_value(path: Path, text: str) -> Any:
    """The value of a JSON text in the file `path`.

    Raises:
        UserError: for any other content.
    """
    try:
        value = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise _damaged(path, "JSON", error) from None
    _check(path, value)
    return value


def read_yaml(path: Path) -> Any:
    """The value of a YAML file.

    Raises:
        UserError: for any other content.
    """
    text = read_text(path, CONFIG_BYTES)
    _check_events(path, text)
    try:
        value = yaml.load(text, LOADER)  # a safe loader
    except (yaml.YAMLError, ValueError, OverflowError) as error:  # a date without such a month
        raise _damaged(path, "YAML", error) from None
    _check(path, value)
    return value


def _check_events(path: Path, text: str) -> None:
    depth = 0
    try:
        for event in yaml.parse(text, Loader=LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise UserError(
                    f"{path}: expected no YAML aliases, got *{event.anchor} in line"
                    f" {event.start_mark.line + 1}; write the values out"
                )
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            require(
                depth <= DEPTH,
                f"{path}: expected at most {DEPTH} nested levels, got more in line"
                f" {event.start_mark.line + 1}; write it flat",
            )
            if isinstance(event, yaml.ScalarEvent):
                _check_text(path, event.value)
    except (yaml.YAMLError, UnicodeError) as error:
        # newer parsers have a limit too, which they may reach first
        require(
            "maximum nesting depth" not in str(error),
            f"{path}: expected at most {DEPTH} nested levels, got many more; write it flat",
        )
        raise _damaged(path, "YAML", error) from None


def _check(path: Path, value: Any, depth: int = 0) -> None:
    require(depth <= DEPTH, f"{path}: expected at most {DEPTH} nested levels, got more; flatten it")
    if isinstance(value, dict):
        for key, item in value.items():
            require(isinstance(key, str), f"{path}: expected texts as keys, got {key!r:.80}")
            _check_text(path, key)
            _check(path, item, depth + 1)
    elif isinstance(value, list):
        for item in value:
            _check(path, item, depth + 1)
    elif isinstance(value, str):
        _check_text(path, value)
    elif isinstance(value, int | float):
        finite = math.isfinite(value) if isinstance(value, float) else abs(value) < LARGEST_INTEGER
        require(finite, f"{path}: expected finite numbers below 2^64, got another; correct it")
    else:
        kind = type(value).__name__
        require(
            value is None, f"{path}: expected texts and numbers, got a {kind}; put it in quotes"
        )


def _check_text(path: Path, text: str) -> None:
    require(
        len(text) <= TEXT_LENGTH,
        f"{path}: expected texts of at most {TEXT_LENGTH:,} characters, got {len(text):,}"
        f" ({text[:40]!r} ...); shorten it",
    )
    require(
        not any("\ud800" <= character <= "\udfff" for character in text),
        f"{path}: expected whole characters, got half of one in {text[:80]!r}; correct it",
    )


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def _damaged(path: Path, kind: str, error: Exception) -> UserError:
    reason = " ".join(str(error).split())[:160] or type(error).__name__
    return UserError(
        f"{path}: expected {kind}, got something else ({reason}); correct it or write it again"
    )
