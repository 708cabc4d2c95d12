"""The command line: from arguments to runs, and from errors to one line and an exit code.

Exit codes:
    0: all runs are complete.
    1: a bug, or a fault of the machine.
    2: bad input, or no space or permission to write.
    3: another process still works on some of the runs.
    130: interrupted.

Nothing heavy is imported before a run starts. Importing this module registers the resolvers that
name run folders, which the processes of a launcher need too.
"""

from __future__ import annotations

import os
import shlex
import sys
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePath
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

import framework
from framework.command import runner
from framework.command.complaints import USER_ERRORS, composing, one_line, with_variant
from framework.command.config.check import check
from framework.command.config.help import help_text
from framework.command.config.naming import plain, register_resolvers, study_name
from framework.command.config.schema import CONF_DIR, register_config
from framework.command.launchers.supported import register_launchers
from framework.command.overrides import check_utf8, normalise, only_informs, parse_flags
from framework.command.runner import Job
from framework.command.studies.failures import again, conclude, record_failure
from framework.command.studies.study import (
    Outcome,
    Refused,
    add_outcome,
    job_count,
    ledger,
    varied,
)
from framework.command.subcommands import run_subcommand, subcommand_of
from framework.compute.orphans import end_with_parent
from framework.errors import UserError, machine_line, printable_line
from framework.files.program import program, take_flag
from framework.records.progress import unread

IN_ALL_LINES = ("augment=", "reg=", "seed=")  # in the progress lines of every run
SHOWN = 32  # characters of another word

register_resolvers()


def main(argv: Sequence[str]) -> int:
    """Run the command line `argv` (without the program's name); returns the exit code."""
    try:
        check_utf8("the current folder", os.getcwd())
        words = take_flag(argv)
        subcommand = subcommand_of(words)
        if subcommand is not None:
            return run_subcommand(subcommand, words[1:])
        if "--version" in argv:
            print(f"fishersplat {framework.__version__}")
            return 0
        arguments = normalise(words)
        with _hydra_process(arguments):
            register_config()
            register_launchers()
            flags = parse_flags(arguments)
            if flags.help:
                print(help_text(flags.overrides))
                return 0
            application = hydra.main(
                version_base="1.3", config_path=str(CONF_DIR), config_name="config"
            )(task)
            if only_informs(flags):
                with composing():
                    application()
                return 0
            with ledger(), composing():
                application()
                return conclude()
    except KeyboardInterrupt:
        again = f"{program()} {shlex.join(argv)}"
        print(f"error: interrupted; results are kept, continue with: {again}", file=sys.stderr)
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
        line = machine_line(error)
        if line is None:
            raise
        print(f"error: {line}", file=sys.stderr)
        return 2
    except SystemExit as end:  # Hydra ends --help and its like this way
        return end.code if isinstance(end.code, int) else int(end.code is not None)


def task(cfg: DictConfig) -> Outcome:
    """Do one run. Hydra calls this, perhaps in a new process of a launcher.

    An error ends only this run and is written into its record and the ledger.

    Returns:
        The run's entry in the ledger.
    """
    end_with_parent()
    job = _job(HydraConfig.get(), plain(cfg))
    try:
        check(job.config)  # also finds plugins, which a launcher's new process has not done
        job.config["study"] = study_name(job.config)
        runner.run(job)
    except SystemExit as end:  # raised by a plugin; it must not end other runs
        return record_failure(
            job, UserError(f"the run called sys.exit({end.code!r}); fix the plugin")
        )
    except Exception as error:
        return record_failure(job, error)
    outcome = Outcome(job.number, job.run_dir)
    add_outcome(outcome)
    return outcome


@contextmanager
def _hydra_process(arguments: Sequence[str]) -> Iterator[None]:
    """Set what `hydra.main` reads from the process: the arguments, and not to catch errors."""
    argv = sys.argv
    sys.argv = [argv[0], *arguments]
    os.environ["HYDRA_FULL_ERROR"] = "1"
    try:
        yield
    finally:
        sys.argv = argv


def _shown(word: str) -> str:
    """Shorten a word of the command line for progress lines: a path to its last two parts, a long
    key to its last name, a long value to its start."""
    key, _, value = word.partition("=")
    name = "/".join(PurePath(value.strip("'\"")).parts[-2:]) if "/" in value else value
    if len(key) + len(name) >= SHOWN:
        key = key.rpartition(".")[2]
    name = printable_line(name)
    return f"{key}={name if len(name) <= SHOWN else name[: SHOWN - 1] + '…'}"


def _job(hydra: Any, config: dict[str, Any]) -> Job:
    """The run of a composed configuration; `hydra` is Hydra's part of it."""
    overrides = [str(override) for override in hydra.overrides.task]
    choices = (str(hydra.runtime.choices.get(group)) for group in ("augment", "reg"))
    plugins = [name for name in choices if name != "none"] or ["baseline"]
    pair = "_".join(plugins)
    words = [word.lstrip("+") for word in varied(overrides)]
    besides = [_shown(w) for w in words if not w.startswith(IN_ALL_LINES) and w != f"method={pair}"]
    label = " ".join(["+".join(plugins), *besides, f"seed {config['seed']}"])
    number = 0 if OmegaConf.is_missing(hydra.job, "num") else int(hydra.job.num)
    total = job_count()
    if total != 1:
        label = f"[run {number + 1}{f' of {total}' if total else ''}] {label}"
    multirun = hydra.mode.name == "MULTIRUN"
    return Job(
        number=number,
        run_dir=str(hydra.runtime.output_dir),
        config=config,
        overrides=overrides,
        label=label,
        alone=not multirun or hydra.launcher._target_.endswith(".BasicLauncher"),
        multirun=multirun,
        again=again(hydra),
    )
