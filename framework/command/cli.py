"""The command line: from arguments to runs, and from errors to one line and an exit code.

Exit codes: 0 all runs are complete · 1 a bug or the machine · 2 bad input, no room or no right to
write · 3 another process is still at some of the runs · 130 interrupted.

Nothing heavy is imported here before a run really starts (`framework.command.runner` begins
beside). Importing this module registers the resolvers that name run folders, which the processes
of a launcher need too.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

import framework
from framework.command import own_plugins, runner
from framework.command.complaints import USER_ERRORS, one_line, with_variant
from framework.command.config.check import check
from framework.command.config.help import help_text
from framework.command.config.naming import NOT_HASHED, plain, register_resolvers, study_name
from framework.command.config.schema import (
    CONF_DIR,
    GROUPS,
    OBJECT_GROUPS,
    choices,
    register_config,
)
from framework.command.config.trust import check_command, parsed, quoted
from framework.command.hydra_inside import argument_parser
from framework.command.job import Job
from framework.command.launchers.detached import detached
from framework.command.launchers.known import register_launchers
from framework.command.program import program
from framework.command.studies.failures import again, conclude, tell
from framework.command.studies.study import Outcome, Refused, add_outcome, job_count, ledger
from framework.command.subcommands import asked_for, obey
from framework.compute.orphans import end_with_parent
from framework.errors import (
    UserError,
    memory_line,
    mendable,
    os_line,
    out_of_memory,
    printable_line,
)
from framework.records.progress import unread
from framework.registry import JOINABLE, JOINED_BY, parts_of

register_resolvers()

MULTIRUN_FLAGS = ("-m", "--multirun")
SWEEP = "sweep"  # the group of the studies' files
ONE_STUDY = f"run them one after the other, each as {SWEEP}=NAME"
LISTED = r"\[([^\[\]]*)\]"  # `[uar,depth_rank]`


def main(argv: Sequence[str]) -> int:
    """Run the command line `argv` (without the program's name); returns the exit code."""
    try:
        _check_here()
        subcommand = asked_for(argv)
        if subcommand is not None:
            return obey(subcommand, argv[1:])
        if "--version" in argv:
            print(f"fishersplat {framework.__version__}")
            return 0
        arguments = normalise(own_plugins.take_flag(argv))
        with _hydra_process(arguments):
            register_config()
            register_launchers()
            flags = _parse(arguments)
            if not flags.shell_completion:  # whose words are no overrides
                check_command(flags)
            if flags.help:
                print(help_text(flags.overrides))
                return 0
            application = hydra.main(
                version_base="1.3", config_path=str(CONF_DIR), config_name="config"
            )(task)
            if _only_informs(flags):
                application()
                return 0
            with ledger():
                application()
                return 0 if detached() else conclude()
    except KeyboardInterrupt:
        line = f"{program()} {shlex.join(argv)}"
        print(f"error: interrupted; what is done is kept, go on with: {line}", file=sys.stderr)
        return 130
    except (Refused, *USER_ERRORS) as error:
        if "traceback=true" in argv:
            traceback.print_exc()
        print(f"error: {with_variant(one_line(error), argv)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # the reader, for instance `head`, has seen enough
        unread(sys.stdout)
        return 0
    except (OSError, MemoryError, RuntimeError, ImportError) as error:
        if "traceback=true" in argv:
            traceback.print_exc()
        if isinstance(error, OSError) and mendable(error):
            print(f"error: {printable_line(os_line(error))}", file=sys.stderr)
            return 2
        if not out_of_memory(error):
            raise
        print(f"error: {printable_line(memory_line(error))}", file=sys.stderr)
        return 2
    except SystemExit as end:  # Hydra ends --help and its like this way
        return end.code if isinstance(end.code, int) else int(end.code is not None)


def task(cfg: DictConfig) -> Outcome | None:
    """One run; Hydra calls it, perhaps in a launcher's fresh process.

    An error ends this run and not its siblings: it goes into the record and the ledger. Returns
    what the ledger has of the run, where this process knows it.
    """
    end_with_parent()
    job = _job(HydraConfig.get(), plain(cfg))
    try:
        check(job.config)  # finds plugins too, of which a launcher's fresh process knows nothing
        job.config["study"] = study_name(job.config)
        well = runner.run(job)
    except Exception as error:
        return tell(job, error)
    if not well:  # told by the process that did it
        return None
    outcome = Outcome(job.number, job.run_dir)
    add_outcome(outcome)
    return outcome


def normalise(argv: Sequence[str]) -> list[str]:
    """`argv` as Hydra accepts it. Raises UserError for a line it could not read.

    A leading `+` goes from known groups: they are in the defaults list, where Hydra wants none.
    """
    _check_utf8("command line", *argv)
    arguments = [re.sub(rf"^\+(?=({'|'.join(GROUPS)})=)", "", argument) for argument in argv]
    arguments = [quoted(_joined_choices(argument)) for argument in arguments]
    _check_multirun_flag(arguments)
    _check_empty_choices(arguments)
    _check_given_twice(arguments)
    flags = _parse(arguments)
    if not flags.shell_completion:  # whose words are no overrides
        _check_one_study(flags.overrides)
    if flags.multirun and _only_informs(flags):
        raise UserError("command line: expected -m or a flag that only informs, got both; drop one")
    if flags.resolve and not flags.cfg:
        raise UserError("command line: expected --cfg beside --resolve, got none; add --cfg job")
    return _options_of_swept_groups(arguments, flags.overrides) if flags.multirun else arguments


def _joined_choices(argument: str) -> str:
    """`reg=none,[uar,depth_rank]` as `reg=none,uar+depth_rank`: several plugins are one choice."""
    group, _, names = argument.partition("=")
    if group not in OBJECT_GROUPS:
        return argument

    def join(listed: re.Match[str]) -> str:
        joined = JOINED_BY.join(name.strip() for name in listed[1].split(","))
        return JOINED_BY.join(parts_of(group, joined))

    return f"{group}={re.sub(LISTED, join, names)}"


def _check_here() -> None:
    """Runs are recorded with the folder that they were started in."""
    try:
        here = os.getcwd()
    except OSError as error:
        raise UserError(
            f"the current folder: expected one that exists, got '{error.strerror}'; change to"
            " another"
        ) from error
    _check_utf8("the current folder", here)


def _check_utf8(where: str, *texts: str) -> None:
    """What the system handed over, where a byte that is no text stands for itself."""
    for text in texts:
        try:
            text.encode("utf-8")
        except UnicodeEncodeError:
            raise UserError(
                f"{where}: expected UTF-8, in which records are written, got {text[:200]!r}; rename"
                " the file or folder"
            ) from None


def _check_multirun_flag(arguments: Sequence[str]) -> None:
    """Hydra's parser takes -m only before or after all overrides."""
    words = [i for i, argument in enumerate(arguments) if "=" in argument]
    for flag in MULTIRUN_FLAGS:
        if flag in arguments and words and words[0] < arguments.index(flag) < words[-1]:
            raise UserError(
                f"command line: expected {flag} first or last, got it in the middle, after"
                f" '{arguments[arguments.index(flag) - 1]}'; move it to the end"
            )


def _check_empty_choices(arguments: Sequence[str]) -> None:
    """`augment=` and `augment=null` would leave a group with options but nothing to have them."""
    for argument in arguments:
        group, equals, name = argument.partition("=")
        if equals and group in OBJECT_GROUPS and name in ("", "null"):
            variants = {file.stem for file in (CONF_DIR / group).glob("*.yaml")}
            known = ", ".join(sorted({*choices(group), *variants}))
            raise UserError(f"{group}: expected a choice, got {name!r}; available: {known}")


def _check_given_twice(arguments: Sequence[str]) -> None:
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
    if key.startswith("hydra") or (key in NOT_HASHED and key != "seed"):  # no values to compare
        return "leave one out"
    single = key in JOINABLE and both.count(",") == 1 and JOINED_BY not in both
    joined = f"{key}=[{both}] for both in one run, " if single else ""
    alone = "" if key in GROUPS else "leave one out, or "
    return f"{alone}write {joined}{key}={both} -m for a run of each"


def _check_one_study(overrides: Sequence[str]) -> None:
    """A study's file says what its runs are: of several, with or without -m, Hydra would mix one's
    options into another's runs."""
    for override in parsed(overrides):
        several = override.is_sweep_override() or isinstance(override.value(), list)
        if override.key_or_group == SWEEP and several:
            raise UserError(
                f"{SWEEP}: expected one study, got several ({override.input_line}); {ONE_STUDY}"
            )


def _parse(arguments: Sequence[str]) -> Any:
    """Hydra's flags; a line its parser refuses becomes a UserError."""

    def refuse(message: str) -> NoReturn:
        raise UserError(f"command line: {message}; --help tells what there is")

    parser = argument_parser()
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


def _only_informs(flags: Any) -> bool:
    """True for `--help`, `--cfg` and the like, which start no run."""
    return bool(flags.help or flags.hydra_help or flags.cfg or flags.info or flags.shell_completion)


@contextmanager
def _hydra_process(arguments: Sequence[str]) -> Iterator[None]:
    """What `hydra.main` reads from the process: its arguments, and to leave errors to us."""
    argv, full_error = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    sys.argv = [argv[0], *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv
        if full_error is None:
            del os.environ["HYDRA_FULL_ERROR"]
        else:
            os.environ["HYDRA_FULL_ERROR"] = full_error


def _job(hydra: Any, config: dict[str, Any]) -> Job:
    """The run of a composed configuration; hydra: Hydra's part of it."""
    method = "+".join(str(hydra.runtime.choices.get(group)) for group in ("augment", "reg"))
    label, short = f"{method} seed {config['seed']}", f"{method} s{config['seed']}"
    number = 0 if OmegaConf.is_missing(hydra.job, "num") else int(hydra.job.num)
    total = job_count()
    if total != 1:
        label = f"[run {number + 1}{f' of {total}' if total else ''}] {label}"
        short = f"[{number + 1}{f'/{total}' if total else ''}] {short}"
    multirun = hydra.mode.name == "MULTIRUN"
    return Job(
        number=number,
        run_dir=str(hydra.runtime.output_dir),
        config=config,
        overrides=[str(override) for override in hydra.overrides.task],
        label=label,
        short_label=short,
        alone=not multirun or hydra.launcher._target_.endswith(".BasicLauncher"),
        multirun=multirun,
        again=again(hydra),
    )
