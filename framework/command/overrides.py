"""The words of the command line: made acceptable to Hydra, or refused in one line.

Hydra would take the last of two values silently, or fail on other mistakes with a traceback.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override

from framework.command.complaints import composing
from framework.command.config.schema import GROUPS, OBJECT_GROUPS
from framework.command.hydra_inside import argument_parser
from framework.errors import UserError, require
from framework.registry import JOINABLE, JOINED_BY, parts_of

MULTIRUN_FLAGS = ("-m", "--multirun")
SWEEP = "sweep"  # the group of the studies' files
ONE_STUDY = f"run them one after the other, each as {SWEEP}=NAME"
LISTED = r"\[([^\[\]]*)\]"  # `[uar,depth_rank]`
GRAMMAR = set("'\"[]{}(),\\$")  # characters with a meaning in the value of an override
QUOTED_ONLY = "#&;<>!~^`"  # ASCII characters that the grammar reads only inside quotation marks
NAMES = ("study", "metrics.lpips_weights", "scene.images", "scene.file")  # values that are names
NUMBER = re.compile(r"[0-9+\-._e]+|true|false|[+-]?(inf|nan)", re.ASCII | re.I)


def normalise(argv: Sequence[str]) -> list[str]:
    """Return `argv` as Hydra accepts it.

    A leading `+` of a group is removed: Hydra wants none for groups of the defaults list.

    Raises:
        UserError: for words that it could not read.
    """
    check_utf8("command line", *argv)
    arguments = [re.sub(rf"^\+(?=({'|'.join(GROUPS)})=)", "", argument) for argument in argv]
    arguments = [quoted(_joined_choices(argument)) for argument in arguments]
    # Hydra's parser takes -m only before or after all overrides
    arguments.sort(key=lambda argument: argument not in MULTIRUN_FLAGS)
    check_given_twice(arguments)
    flags = parse_flags(arguments)
    if not flags.shell_completion:  # whose words are no overrides
        _check_choices(parsed(flags.overrides))
    if flags.multirun and only_informs(flags):
        raise UserError("command line: expected -m or a flag that only informs, got both; drop one")
    if flags.resolve and not flags.cfg:
        raise UserError("command line: expected --cfg with --resolve, got none; add --cfg job")
    return _options_of_swept_groups(arguments, flags.overrides) if flags.multirun else arguments


def parse_flags(arguments: Sequence[str]) -> Any:
    """Parse Hydra's flags. Raises UserError."""

    def refuse(message: str) -> NoReturn:
        raise UserError(f"command line: {message}; --help lists the flags")

    parser = argument_parser()
    parser.allow_abbrev = False  # `--versio` would print Hydra's version
    parser.error = refuse  # type: ignore[method-assign]
    return parser.parse_args(arguments)


def parsed(words: Sequence[str]) -> list[Override]:
    """Parse overrides by Hydra's grammar.

    Raises:
        UserError: or one of Hydra's errors.
    """
    with composing():
        overrides = OverridesParser.create().parse_overrides(list(words))
    for override in overrides:
        require(
            override.key_or_group != "",
            f"command line: cannot read {str(override.input_line)[:100]!r}; write KEY=VALUE",
        )
    return overrides


def quoted(word: str) -> str:
    """Quote a value that Hydra's grammar would not read as text.

    `scene.path=my phötos` becomes `scene.path='my phötos'`, unless the value has characters of a
    list, a sweep or a quotation. The names of files, folders and studies are always text:
    `2024_05_12` is no number.
    """
    key, equals, value = word.partition("=")
    is_name = key.lstrip("+") in NAMES or key.endswith(".path")
    unreadable = any(not sign.isascii() or sign in QUOTED_ONLY for sign in value)
    unreadable = unreadable or (is_name and NUMBER.fullmatch(value) is not None)
    return f"{key}='{value}'" if equals and unreadable and not set(value) & GRAMMAR else word


def only_informs(flags: Any) -> bool:
    """Whether the flags (`--help`, `--cfg`, ...) start no run."""
    return bool(flags.help or flags.hydra_help or flags.cfg or flags.info or flags.shell_completion)


def check_utf8(where: str, *texts: str) -> None:
    """Raise UserError for text that is not UTF-8, which no record could hold."""
    for text in texts:
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:
            raise UserError(
                f"{where}: expected UTF-8, in which records are written, got {text[:200]!r}; rename"
                " the file or folder"
            ) from None


def check_given_twice(words: Sequence[str]) -> None:
    """Raise UserError for `seed=1 seed=2`, of which Hydra would take the last silently.

    A study's file may have the same keys; the command line replaces those.
    """
    first: dict[str, str] = {}
    for word in words:
        key, equals, _ = word.partition("=")
        key = key.lstrip("+")
        if not equals or key.startswith(("-", "~")):
            continue
        if key in first:
            expected = "choice" if key in GROUPS else "value"
            raise UserError(
                f"{key}: expected one {expected}, got two words ({first[key]} and {word});"
                f" {_instead_of_two(key, first[key], word)}"
            )
        first[key] = word


def check_method(overrides: Sequence[Override], swept: Iterable[Any]) -> None:
    """Check a `method=` together with `augment=` and `reg=`, given or swept.

    Prints a note if one of its two choices is replaced.

    Raises:
        UserError: if both are, since the method would change nothing.
    """
    chosen = {override.get_key_element(): override.input_line for override in overrides}
    if "method" in chosen and {"augment", "reg"} <= {*chosen, *swept}:
        raise UserError(
            f"{chosen['method']}: expected no method together with augment and reg, which replace"
            " both of its choices; leave it out, or leave them out"
        )
    for group in ("augment", "reg"):
        if "method" in chosen and group in chosen:
            note = f"note: {chosen[group]} replaces the {group} of {chosen['method']}"
            print(note, file=sys.stderr)  # what --cfg prints is data


def _joined_choices(argument: str) -> str:
    """`reg=none,[uar,depth_rank]` as `reg=none,uar+depth_rank`: several plugins are one choice."""
    group, equals, names = argument.partition("=")
    if group not in OBJECT_GROUPS or not equals:  # `--package reg`
        return argument

    def join(listed: re.Match[str]) -> str:
        joined = JOINED_BY.join(name.strip() for name in listed[1].split(","))
        return JOINED_BY.join(parts_of(group, joined))

    return f"{group}={re.sub(LISTED, join, names)}"


def _options_of_swept_groups(arguments: Sequence[str], overrides: Sequence[str]) -> list[str]:
    """Make `augment.eta=1.5` a sweep of one value if `augment` is swept.

    Hydra first composes a configuration without the swept keys, where the group has its default
    choice, which may lack the option.
    """
    values = parsed(overrides)
    swept = {o.key_or_group for o in values if o.is_sweep_override()} & set(OBJECT_GROUPS)
    fixed = {
        o.input_line
        for o in values
        if o.key_or_group.partition(".")[0] in swept
        and "." in o.key_or_group
        and not o.is_sweep_override()
    }
    return [re.sub("=(.*)", r"=choice(\1)", a, count=1) if a in fixed else a for a in arguments]


def _instead_of_two(key: str, first: str, second: str) -> str:
    """What to write instead of two words with one key."""
    if key == SWEEP:
        return ONE_STUDY
    both = f"{first.partition('=')[2]},{second.partition('=')[2]}"
    alone = "" if key in GROUPS else "leave one out, or "
    joined = f"{key}=[{both}] for both in one run, or " if key in JOINABLE else ""
    return f"{alone}write {joined}{key}={both} -m for a run of each"


def _check_choices(overrides: Sequence[Override]) -> None:
    """Refuse `preset=[a,b]` and several studies, whose options Hydra would mix, and `reg=null`,
    `~reg` and `~seed`: no part of a configuration can be removed."""
    for override in overrides:
        group, removed = override.key_or_group, override.is_delete()
        require(
            group not in OBJECT_GROUPS or not (removed or override.value() in (None, "")),
            f"{group}: expected a choice, got none; write {group}=NAME, --help lists them",
        )
        require(
            not removed or group in ("experiment", SWEEP) or group.startswith("hydra"),
            f"~{group}: an option cannot be removed; leave this word out for the default",
        )
        several = isinstance(override.value(), list)
        several = several or (group == SWEEP and override.is_sweep_override())
        advice = f"write {group}=NAME, or {group}=a,b -m for a run of each"
        require(
            group not in GROUPS or not several,
            f"{group}: expected one choice, got several ({override.input_line});"
            f" {ONE_STUDY if group == SWEEP else advice}",
        )
