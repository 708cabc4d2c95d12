"""The overrides of a command line: how they are read, and the mistakes that Hydra lets pass.

The command line and the user's configurations are trusted, as everywhere with Hydra (SECURITY.md).
What is refused here would silently do something else than it says, or list runs for minutes.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep

from framework.command.config.schema import GROUPS, OBJECT_GROUPS
from framework.command.program import program
from framework.errors import UserError, printable_line, require
from framework.files import limits

OF_GRAMMAR = set("'\"[]{}(),\\$")  # signs that mean something in the value of an override
NAMES = ("study", "metrics.lpips_weights", "scene.images", "scene.file")  # values that are names
NO_NAME = re.compile(r"[0-9+\-._e]+|true|false|[+-]?(inf|nan)", re.ASCII | re.I)  # a value of those
REMOVABLE = {*GROUPS} - {*OBJECT_GROUPS, "method", "preset"}
NO_WORDS = "#&;<>!~^`"  # of ASCII, what it reads only in quotation marks


def parsed(lines: Sequence[str]) -> list[Override]:
    """The overrides as Hydra's grammar reads them. Raises UserError, or one of Hydra's, for a line
    that it cannot read, or would read for minutes."""
    try:
        overrides = OverridesParser.create().parse_overrides(list(lines))
    except (ValueError, RecursionError) as error:  # an integer of thousands of digits, for instance
        raise UserError(
            f"command line: expected values of a usual length, got others"
            f" ({printable_line(str(error))[:120]}); write KEY=VALUE"
        ) from error
    for override in overrides:
        require(
            override.key_or_group != "",
            f"command line: cannot read {str(override.input_line)[:100]!r}; write KEY=VALUE",
        )
    return overrides


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
            note = f"note: {choice} takes the place of what {method} has as {group}"
            print(note, file=sys.stderr)  # what --cfg prints is data


def check_deleted(overrides: Iterable[Override]) -> None:
    """Raise UserError for `~reg` and `~seed`: no part of a configuration can be removed."""
    for override in overrides:
        key = override.key_or_group
        if not override.is_delete() or key in REMOVABLE or key.startswith("hydra"):
            continue
        require(
            key not in OBJECT_GROUPS,
            f"~{key}: expected a choice of {key}, got none; write {key}=NAME, {program()} --help"
            " tells which",
        )
        raise UserError(
            f"~{key}: an option cannot be removed; leave this word out for the default, or write"
            f" {key}=VALUE"
        )


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
        require(
            all(map(math.isfinite, (value.start, value.stop, value.step))),
            f"{override.input_line}: expected finite bounds and step, got others; change them",
        )
        require(value.step != 0, f"{override.input_line}: expected a step other than 0; change it")
        return max(0, math.ceil((value.stop - value.start) / value.step))
    return 1
