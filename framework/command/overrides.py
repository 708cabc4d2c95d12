"""The words of the command line: made acceptable to Hydra, or refused in one line.

Hydra would take the last of two values silently, fail on other mistakes with a traceback, or list
runs for minutes. The command line and the user's configurations are trusted (SECURITY.md).
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NoReturn

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, IntervalSweep, Override, RangeSweep

from framework.command.config.schema import CONF_DIR, GROUPS, OBJECT_GROUPS, choices
from framework.command.hydra_inside import argument_parser
from framework.command.program import program
from framework.errors import UserError, printable_line, require
from framework.files import limits
from framework.records.provenance import NEUTRAL_KEYS
from framework.registry import JOINABLE, JOINED_BY, parts_of

MULTIRUN_FLAGS = ("-m", "--multirun")
SWEEP = "sweep"  # the group of the studies' files
ONE_STUDY = f"run them one after the other, each as {SWEEP}=NAME"
LISTED = r"\[([^\[\]]*)\]"  # `[uar,depth_rank]`
GRAMMAR = set("'\"[]{}(),\\$")  # characters with a meaning in the value of an override
QUOTED_ONLY = "#&;<>!~^`"  # ASCII characters that the grammar reads only inside quotation marks
NAMES = ("study", "metrics.lpips_weights", "scene.images", "scene.file")  # values that are names
NUMBER = re.compile(r"[0-9+\-._e]+|true|false|[+-]?(inf|nan)", re.ASCII | re.I)
REMOVABLE = {*GROUPS} - {*OBJECT_GROUPS, "method", "preset"}


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
    _check_empty_choices(arguments)
    check_given_twice(arguments)
    flags = parse_flags(arguments)
    if not flags.shell_completion:  # whose words are no overrides
        overrides = parsed(flags.overrides)
        _check_single_choices(overrides)
        _check_deleted(overrides)
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
    try:
        overrides = OverridesParser.create().parse_overrides(list(words))
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


def check_run_count(overrides: Sequence[Override], params: Mapping[Any, Any]) -> None:
    """Raise UserError for more than `limits.RUNS` runs, without listing them.

    Args:
        overrides: of the command line.
        params: `hydra.sweeper.params`; overrides of the same keys replace them.
    """
    swept = parsed([f"{key!s}={value}" for key, value in params.items()])
    lengths = {override.get_key_element(): _length(override) for override in [*swept, *overrides]}
    count = math.prod(lengths.values())
    require(
        count <= limits.RUNS,
        f"multirun: expected at most {limits.RUNS:,} runs, got {count:,}; sweep fewer values",
    )


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


def _check_empty_choices(arguments: Sequence[str]) -> None:
    """Refuse `augment=` and `augment=null`: the group would have options but no choice."""
    for argument in arguments:
        group, equals, name = argument.partition("=")
        if equals and group in OBJECT_GROUPS and name in ("", "null"):
            variants = {file.stem for file in (CONF_DIR / group).glob("*.yaml")}
            names = ", ".join(sorted({*choices(group), *variants}))
            raise UserError(f"{group}: expected a choice, got {name!r}; available: {names}")


def _instead_of_two(key: str, first: str, second: str) -> str:
    """What to write instead of two words with one key."""
    both = f"{first.partition('=')[2]},{second.partition('=')[2]}"
    if key == SWEEP:
        return ONE_STUDY
    if key.startswith("hydra") or key in NEUTRAL_KEYS:  # no values to compare
        return "leave one out"
    single = key in JOINABLE and both.count(",") == 1 and JOINED_BY not in both
    joined = f"{key}=[{both}] for both in one run, " if single else ""
    alone = "" if key in GROUPS else "leave one out, or "
    return f"{alone}write {joined}{key}={both} -m for a run of each"


def _check_single_choices(overrides: Sequence[Override]) -> None:
    """Refuse `preset=[a,b]`, and several studies: Hydra would mix their options."""
    for override in overrides:
        group, listed = override.key_or_group, isinstance(override.value(), list)
        if group == SWEEP and (listed or override.is_sweep_override()):
            raise UserError(
                f"{SWEEP}: expected one study, got several ({override.input_line}); {ONE_STUDY}"
            )
        if group in GROUPS and listed:
            raise UserError(
                f"{group}: expected one choice, got a list ({override.input_line}); write"
                f" {group}=NAME, or {group}=a,b -m for a run of each"
            )


def _check_deleted(overrides: Iterable[Override]) -> None:
    """Refuse `~reg` and `~seed`: no part of a configuration can be removed."""
    for override in overrides:
        key = override.key_or_group
        if not override.is_delete() or key in REMOVABLE or key.startswith("hydra"):
            continue
        require(
            key not in OBJECT_GROUPS,
            f"~{key}: expected a choice of {key}, got none; write {key}=NAME, {program()} --help"
            " lists them",
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
        f"{override.input_line}: expected a list of values, such as choice(0,0.5,1) or"
        " range(0,1.1,0.5), got an interval; list the values",
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
