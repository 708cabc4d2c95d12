"""A lone run in two processes: one imports the trainer while the other reads the command line.

Hydra takes a second to be imported and to compose a configuration, torch and the kernels two, what
a report needs one more. So before anything is imported `run.py` forks: the child is the command
line, from its arguments to the report and the exit code; its parent, which has the number that the
shell knows, does the run as soon as the child asks for it. A study of many runs saves little by it
and stays in one process, as does whoever calls `framework.cli` from Python.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import signal
import sys
import threading
import traceback
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NoReturn

from framework.collector import import_uncollected
from framework.orphans import watch
from framework.progress import Progress

EXPERIMENT = "framework.experiment"
REPORT = ("framework.report", "pandas", "matplotlib.backends.backend_svg", "PIL.WebPImagePlugin")
INTERRUPT = signal.SIGUSR1  # to the child: the run was interrupted, tell so

_parent: Connection | None = None  # in the child: whom to ask for runs


def command(argv: Sequence[str]) -> NoReturn:
    """Obey the command line `argv` (without the program's name) and end this process."""
    if not any(word.startswith("-") for word in argv):
        code = lone(argv)
        with contextlib.suppress(OSError):  # what could not be told was not told before, either
            sys.stdout.flush()
        os._exit(code)  # all is written: taking torch apart takes 0.2 s
    from framework.cli import main  # a study, or only information

    code = main(argv)
    gc.freeze()  # freeing torch's objects one by one takes 0.7 s
    sys.exit(code)


def lone(argv: Sequence[str]) -> int:
    """The exit code of a lone run, in two processes."""
    ours, theirs = Pipe()
    shell, child = os.getpid(), os.fork()
    if child == 0:
        ours.close()
        os._exit(_command_line(argv, theirs, shell))
    theirs.close()
    try:
        _serve(ours)
    except KeyboardInterrupt:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # once is enough
        os.kill(child, INTERRUPT)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return code if code >= 0 else 128 - code


def run(
    config: Mapping[str, Any], run_dir: Path, progress: Progress, overrides: Sequence[str]
) -> None:
    """`framework.experiment.run_experiment`, by the parent if it waits for runs. Raises what that
    raises."""
    if _parent is None:
        import_uncollected(EXPERIMENT)
        from framework.experiment import run_experiment

        run_experiment(config, run_dir, progress, overrides)
        return
    _parent.send((config, run_dir, progress, overrides))
    if config["threads"] != 1:  # else the core is for the run
        _importing(REPORT)
    try:
        raised = _parent.recv()
    except EOFError:  # killed: leave everything as it left it
        os._exit(1)
    if raised is not None:
        raise _unpacked(raised)


def _command_line(argv: Sequence[str], parent: Connection, shell: int) -> int:
    """What the child does, which returns to nobody."""
    global _parent
    code = 1
    try:
        signal.signal(INTERRUPT, signal.default_int_handler)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run
        watch(shell)
        _parent = parent
        from framework.cli import main

        code = main(argv)
        sys.stdout.flush()
    except BaseException:
        traceback.print_exc()
    sys.stderr.flush()
    return code


def _serve(child: Connection) -> None:
    """Do the runs that the child asks for, until it has ended."""
    imports = _importing([EXPERIMENT])
    while True:
        try:
            wanted = child.recv()
        except (EOFError, ConnectionResetError):
            return
        imports.join()
        child.send(_outcome(*wanted))


def _importing(modules: Sequence[str]) -> threading.Thread:
    """Import `modules` in a thread; an error is met by whoever imports them next."""

    def work() -> None:
        for module in modules:
            import_uncollected(module)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def _outcome(*wanted: Any) -> list[bytes] | None:
    """None if the run went well, else what it raised."""
    try:
        run(*wanted)
    except Exception as error:
        return _packed(error)
    return None


class Elsewhere(Exception):
    """The traceback of an error in the other process, as text."""


def _packed(error: BaseException) -> list[bytes]:
    """`error` and what it arose from, for another process; the last is its traceback."""
    text = "".join(traceback.format_exception(error))
    chain: list[BaseException] = []
    cause: BaseException | None = error
    while cause is not None:
        chain.append(cause)
        cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)
    return [*map(_pickled, chain), _pickled(Elsewhere(f"\n{text}"))]


def _pickled(error: BaseException) -> bytes:
    """An error that cannot be sent is sent as its text."""
    try:
        pickle.loads(data := pickle.dumps(error))
    except Exception:
        return pickle.dumps(RuntimeError(f"{type(error).__name__}: {error}"))
    return data


def _unpacked(errors: Sequence[bytes]) -> Exception:
    error, *causes = map(pickle.loads, errors)
    last = error
    for cause in causes:
        last.__cause__ = cause
        last = cause
    raised: Exception = error
    return raised
