"""A lone run in two processes: one imports the trainer while the other reads the command line.

Hydra takes a second to be imported and to compose a configuration, torch and the kernels two, what
a report needs one more. So before anything is imported `run.py` forks: the child is the command
line, from its arguments to the report and the exit code; its parent, which has the number that the
shell knows, does the run as soon as the child asks for it. A study of many runs saves little by it
and stays in one process, as does whoever calls `framework.command.cli` from Python.

The child sends a run as a line of JSON; the answer is whether it went well. A run that failed has
been told by then, in its record and the ledger (`framework.command.studies.failures`); see
`framework.command.runner`.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import socket
import sys
import traceback
from collections.abc import Sequence
from typing import NoReturn, TextIO

from framework.command import runner
from framework.command.program import CONSOLE, SCRIPT, typed
from framework.command.streams import make_safe
from framework.compute.orphans import watch
from framework.errors import memory_line
from framework.files.limits import check_address_space

INTERRUPT = signal.SIGUSR1  # to the child: the run was interrupted, tell so
SIGNALS = (signal.SIGINT, INTERRUPT)


def main() -> NoReturn:
    """The console command `fishersplat`."""
    try:
        command(sys.argv[1:], CONSOLE)
    except KeyboardInterrupt:
        sys.exit(_interrupted())


def command(argv: Sequence[str], name: str = SCRIPT) -> NoReturn:
    """Obey the command line `argv` of the program `name` and end this process."""
    typed(name)
    make_safe()
    try:
        check_address_space()
    except MemoryError as error:
        print(f"error: {memory_line(error)}", file=sys.stderr)
        sys.exit(2)
    if all("=" in word and not word.startswith("-") for word in argv):
        try:
            code = lone(argv)
        except KeyboardInterrupt:  # before there were two
            code = _interrupted()
        _flush()
        os._exit(code)  # all is written: taking torch apart takes 0.2 s
    from framework.command.cli import main  # a study, or only information

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
        from framework.command.cli import main

        return main(argv)
    if child == 0:
        asking.close()
        ours.close()
        os._exit(_command_line(argv, asked, shell))
    try:
        asked.close()
        theirs.close()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        runner.serve(asking)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, lambda *_: os.kill(child, signal.SIGKILL))  # a second time
        os.kill(child, INTERRUPT)
        ours.shutdown(socket.SHUT_RDWR)  # should it be reading: another thread may get the signal
        ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        return _interrupted() if ended == -INTERRUPT else 130
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code if code >= 0 else 128 - code


def _command_line(argv: Sequence[str], parent: TextIO, shell: int) -> int:
    """What the child does, which returns to nobody."""
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
        watch(shell)
        runner.ask(parent)
        from framework.command.cli import main

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
