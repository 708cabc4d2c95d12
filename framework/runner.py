"""A lone run in two processes: one imports the trainer while the other reads the command line.

Hydra takes a second to be imported and to compose a configuration, torch and the kernels two, what
a report needs one more. So before anything is imported `run.py` forks: the child is the command
line, from its arguments to the report and the exit code; its parent, which has the number that the
shell knows, does the run as soon as the child asks for it. A study of many runs saves little by it
and stays in one process, as does whoever calls `framework.cli` from Python.

The child sends a run as a line of JSON; the answer is whether it went well. A run that failed has
been told by then, in its record and the ledger (`framework.failures`).
"""

from __future__ import annotations

import contextlib
import dataclasses
import gc
import json
import os
import signal
import socket
import sys
import threading
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TextIO

from framework.collector import import_uncollected
from framework.errors import UserError
from framework.orphans import watch
from framework.progress import Terminal

EXPERIMENT = "framework.experiment"
REPORT = ("framework.report", "pandas", "matplotlib.backends.backend_svg", "PIL.WebPImagePlugin")
VARIABLES = "FISHERSPLAT_"  # what the environment knows of the command, see `framework.study`
INTERRUPT = signal.SIGUSR1  # to the child: the run was interrupted, tell so
SIGNALS = (signal.SIGINT, INTERRUPT)

_parent: TextIO | None = None  # in the child: whom to ask for runs


@dataclass(frozen=True)
class Job:
    """One run as the command line wants it, of plain data. label, short_label: who speaks in
    progress lines. alone: no other run writes to the terminal. multirun: one of several runs.
    again: the command that does this run alone."""

    number: int
    run_dir: str
    config: dict[str, Any]
    overrides: list[str]
    label: str
    short_label: str
    alone: bool
    multirun: bool
    again: str


def command(argv: Sequence[str]) -> NoReturn:
    """Obey the command line `argv` (without the program's name) and end this process."""
    if not any(word.startswith("-") for word in argv):
        try:
            code = lone(argv)
        except KeyboardInterrupt:  # before there were two
            code = _interrupted()
        _flush()
        os._exit(code)  # all is written: taking torch apart takes 0.2 s
    from framework.cli import main  # a study, or only information

    code = main(argv)
    gc.freeze()  # freeing torch's objects one by one takes 0.7 s
    sys.exit(code)


def lone(argv: Sequence[str]) -> int:
    """The exit code of a lone run, in two processes."""
    ours, theirs = socket.socketpair()
    asking, asked = ours.makefile("rw"), theirs.makefile("rw")
    shell = os.getpid()
    signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # until both know what to do with them
    try:
        child = os.fork()
    except OSError:  # no room for another process
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        from framework.cli import main

        return main(argv)
    if child == 0:
        asking.close()
        ours.close()
        os._exit(_command_line(argv, asked, shell))
    try:
        asked.close()
        theirs.close()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        _serve(asking)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, lambda *_: os.kill(child, signal.SIGKILL))  # a second time
        os.kill(child, INTERRUPT)
        ours.shutdown(socket.SHUT_RDWR)  # should it be reading: another thread may get the signal
        ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return _interrupted() if ended == -INTERRUPT else 130
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code if code >= 0 else 128 - code


def run(job: Job) -> bool:
    """Do a run, by the parent if it waits for them. Raises what the run raises, or returns False
    where the parent has told of it."""
    if _parent is not None:
        return _asked(_parent, job)
    import_uncollected(EXPERIMENT)
    from framework.experiment import run_experiment

    progress = Terminal(job.label, job.short_label, in_place=None if job.alone else False)
    run_experiment(job.config, Path(job.run_dir), progress, job.overrides)
    return True


def _asked(parent: TextIO, job: Job) -> bool:
    """Whether the run went well that the parent does."""
    known = {name: text for name, text in os.environ.items() if name.startswith(VARIABLES)}
    answer = ""
    with contextlib.suppress(ConnectionError):
        print(json.dumps([known, dataclasses.asdict(job)]), file=parent, flush=True)
        if job.config["threads"] != 1:  # else the core is for the run
            _importing(REPORT)
        answer = parent.readline()
    if not answer:  # the run was killed: leave everything as it left it
        os._exit(1)
    well = json.loads(answer)
    if well is None:
        raise KeyboardInterrupt
    if isinstance(well, str):
        raise UserError(well)
    return bool(well)


def _command_line(argv: Sequence[str], parent: TextIO, shell: int) -> int:
    """What the child does, which returns to nobody."""
    global _parent
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        watch(shell)
        _parent = parent
        from framework.cli import main

        signal.signal(INTERRUPT, signal.default_int_handler)  # before, it ends this process
        code = main(argv)
    except BaseException:
        traceback.print_exc()
    _flush()
    return code


def _interrupted() -> int:
    print("error: interrupted", file=sys.stderr)
    return 130


def _flush() -> None:
    """What cannot be told now could not be told before; a closed stream is None."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, AttributeError):
            stream.flush()


def _serve(child: TextIO) -> None:
    """Do the runs that the child asks for, until it has ended."""
    imports = _importing([EXPERIMENT])
    with contextlib.suppress(ConnectionError):
        for line in child:
            known, wanted = json.loads(line)
            os.environ.update(known)
            well: bool | str | None = None  # interrupted
            with contextlib.suppress(KeyboardInterrupt):
                imports.join()
                well = _done(Job(**wanted))
            print(json.dumps(well), file=child, flush=True)


def _done(job: Job) -> bool | str:
    """Whether the run went well; a text where it did not and that could not be told, either."""
    try:
        return run(job)
    except Exception as error:
        from framework.failures import tell

        try:
            tell(job, error)
        except Exception as lost:
            return str(lost) if isinstance(lost, UserError) else f"{type(lost).__name__}: {lost}"
        return False


def _importing(modules: Sequence[str]) -> threading.Thread:
    """Import `modules` in a thread; an error is met by whoever imports them next."""

    def work() -> None:
        with contextlib.suppress(Exception):
            for module in modules:
                import_uncollected(module)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread
