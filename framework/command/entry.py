"""The program: `fishersplat ...` or `python run.py ...`, from its arguments to the exit code.

Modules are imported where Ctrl-C is caught, so that it never prints a traceback.
"""

import contextlib
import gc
import io
import os
import sys


def main() -> None:
    """The console command `fishersplat`."""
    command(sys.argv[1:], "fishersplat")


def command(argv: list[str], name: str) -> None:
    """Run the command line `argv` of the program `name` and end this process."""
    try:
        code = _run(argv, name)
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        code = 130
    gc.freeze()  # freeing torch's objects one by one takes 0.7 s
    sys.exit(code)


def _run(argv: list[str], name: str) -> int:
    """Return the exit code of a command line."""
    from framework.errors import memory_line
    from framework.files.limits import check_address_space
    from framework.files.program import set_program

    set_program(name)
    make_safe()
    try:
        check_address_space()
    except MemoryError as error:
        print(f"error: {memory_line(error)}", file=sys.stderr)
        return 2
    from framework.command.cli import main  # imports Hydra, but not torch

    return main(argv)


def make_safe() -> None:
    """Keep a closed stdout or stderr, or one that cannot encode a letter, from raising."""
    with contextlib.suppress(OSError):
        while os.open(os.devnull, os.O_RDWR) <= 2:  # takes the lowest number that is free
            pass
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # was closed at the start
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))  # noqa: SIM115
        elif name != "stdin" and type(stream) is io.TextIOWrapper:
            stream.reconfigure(errors="backslashreplace")
