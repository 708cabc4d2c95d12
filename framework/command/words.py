"""The words of the command line: made what Hydra accepts, or refused in one line.

Hydra would take the last of two values without a word, and refuse other slips with a traceback.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NoReturn

from hydra.core.override_parser.types import Override

from framework.command.config.overrides import check_deleted, parsed, quoted
from framework.command.config.schema import CONF_DIR, GROUPS, OBJECT_GROUPS, choices
from framework.command.hydra_inside import argument_parser
from framework.errors import UserError
from framework.records.provenance import NEUTRAL_KEYS
from framework.registry import JOINABLE, JOINED_BY, parts_of

MULTIRUN_FLAGS = ("-m", "--multirun")
SWEEP = "sweep"  # the group of the studies' files
ONE_STUDY = f"run them one after the other, each as {SWEEP}=NAME"
LISTED = r"\[([^\[\]]*)\]"  # `[uar,depth_rank]`


def normalise(argv: Sequence[str]) -> list[str]:
    """`argv` as Hydra accepts it. Raises UserError for a line it could not read.

    A leading `+` goes from known groups: they are in the defaults list, where Hydra wants none.
    """
    check_utf8("command line", *argv)
    arguments = [re.sub(rf"^\+(?=({'|'.join(GROUPS)})=)", "", argument) for argument in argv]
    arguments = [quoted(_joined_choices(argument)) for argument in arguments]
    arguments = _multirun_flag_first(arguments)
    _check_empty_choices(arguments)
    check_given_twice(arguments)
    flags = parse(arguments)
    if not flags.shell_completion:  # whose words are no overrides
        overrides = parsed(flags.overrides)
        _check_single_choices(overrides)
        check_deleted(overrides)
    if flags.multirun and only_informs(flags):
        raise UserError("command line: expected -m or a flag that only informs, got both; drop one")
    if flags.resolve and not flags.cfg:
        raise UserError("command line: expected --cfg beside --resolve, got none; add --cfg job")
    return _options_of_swept_groups(arguments, flags.overrides) if flags.multirun else arguments


def _joined_choices(argument: str) -> str:
    """`reg=none,[uar,depth_rank]` as `reg=none,uar+depth_rank`: several plugins are one choice."""
    group, equals, names = argument.partition("=")
    if group not in OBJECT_GROUPS or not equals:  # `--package reg`
        return argument

    def join(listed: re.Match[str]) -> str:
        joined = JOINED_BY.join(name.strip() for name in listed[1].split(","))
        return JOINED_BY.join(parts_of(group, joined))

    return f"{group}={re.sub(LISTED, join, names)}"


def parse(arguments: Sequence[str]) -> Any:
    """Hydra's flags; a line its parser refuses becomes a UserError."""

    def refuse(message: str) -> NoReturn:
        raise UserError(f"command line: {message}; --help tells what there is")

    parser = argument_parser()
    parser.allow_abbrev = False  # `--versio` would print Hydra's version
    parser.error = refuse  # type: ignore[method-assign]
    return parser.parse_args(arguments)


def _options_of_swept_groups(arguments: Sequence[str], overrides: Sequence[str]) -> list[str]:
    """Make `augment.eta=1.5` beside `augment=safi,other` a sweep of one value.

    Hydra first composes a configuration without the swept keys, where the group has its default
    choice and the option does not exist.
    """
    given = parsed(overrides)
    swept = {o.key_or_group for o in given if o.is_sweep_override()} & set(OBJECT_GROUPS)
    fixed = {
        o.input_line
        for o in given
        if o.key_or_group.partition(".")[0] in swept
        and "." in o.key_or_group
        and not o.is_sweep_override()
    }
    return [re.sub("=(.*)", r"=choice(\1)", a, count=1) if a in fixed else a for a in arguments]


def only_informs(flags: Any) -> bool:
    """True for `--help`, `--cfg` and the like, which start no run."""
    return bool(flags.help or flags.hydra_help or flags.cfg or flags.info or flags.shell_completion)


def check_utf8(where: str, *texts: str) -> None:
    """Raise UserError for a text with bytes that are not UTF-8: no record could hold it."""
    for text in texts:
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:
            raise UserError(
                f"{where}: expected UTF-8, in which records are written, got {text[:200]!r}; rename"
                " the file or folder"
            ) from None


def _multirun_flag_first(arguments: Sequence[str]) -> list[str]:
    """-m may stand anywhere: Hydra's parser takes it only before or after all overrides."""
    flags = [argument for argument in arguments if argument in MULTIRUN_FLAGS]
    return flags + [argument for argument in arguments if argument not in MULTIRUN_FLAGS]


def _check_empty_choices(arguments: Sequence[str]) -> None:
    """`augment=` and `augment=null` would leave a group with options but nothing to have them."""
    for argument in arguments:
        group, equals, name = argument.partition("=")
        if equals and group in OBJECT_GROUPS and name in ("", "null"):
            variants = {file.stem for file in (CONF_DIR / group).glob("*.yaml")}
            names = ", ".join(sorted({*choices(group), *variants}))
            raise UserError(f"{group}: expected a choice, got {name!r}; available: {names}")


def check_given_twice(arguments: Sequence[str]) -> None:
    """Of `seed=1 seed=2` Hydra takes the last without a word. Those of a sweep's file are not
    words of the command line, which replaces them."""
    given: dict[str, str] = {}
    for argument in arguments:
        key, equals, _ = argument.partition("=")
        key = key.lstrip("+")
        if not equals or key.startswith(("-", "~")):
            continue
        if key in given:
            expected = "choice" if key in GROUPS else "value"
            raise UserError(
                f"{key}: expected one {expected}, got two words ({given[key]} and {argument});"
                f" {_in_place_of_two(key, given[key], argument)}"
            )
        given[key] = argument


def _in_place_of_two(key: str, first: str, second: str) -> str:
    """What to write where two words have one key: many mean both values."""
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
    """Raise UserError for `preset=[a,b]`, and for several studies in any way: a study's file says
    what its runs are, and Hydra would mix one's options into another's runs."""
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
