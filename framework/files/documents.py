"""Reads JSON from strangers as plain values within limits, and YAML of this project's files.

The values are mappings with strings as keys, lists, strings, numbers, booleans and null. Their size
is bounded by that of the file; there is no deep nesting and no lone surrogate.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import yaml

from framework.errors import require
from framework.files.limits import CONFIG_BYTES, DEPTH, TEXT_LENGTH
from framework.files.opened import read_text, reading

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
    with reading(path, "JSON", "correct it or write it again"):
        value = json.loads(text, parse_constant=_no_constant)
    _check(path, value)
    return value


def read_yaml(path: Path) -> Any:
    """The value of a YAML file of the configuration, which is trusted.

    Raises:
        UserError: for damaged content.
    """
    with reading(path, "YAML", "correct it"):
        value = yaml.load(read_text(path, CONFIG_BYTES), LOADER)  # a safe loader
    return value


def _check(path: Path, value: Any, depth: int = 0) -> None:
    require(depth <= DEPTH, f"{path}: expected at most {DEPTH} nested levels, got more; flatten it")
    if isinstance(value, dict):
        for key, item in value.items():
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
