"""The program: `fishersplat ...` or `python run.py ...`, from its arguments to the exit code."""

from __future__ import annotations

import gc
import sys
from collections.abc import Sequence
from typing import NoReturn

from framework.command.program import CONSOLE, SCRIPT, set_program
from framework.command.streams import make_safe
from framework.errors import memory_line
from framework.files.limits import check_address_space


def main() -> NoReturn:
    """The console command `fishersplat`."""
    command(sys.argv[1:], CONSOLE)


def command(argv: Sequence[str], name: str = SCRIPT) -> NoReturn:
    """Run the command line `argv` of the program `name` and end this process."""
    set_program(name)
    make_safe()
    try:
        check_address_space()
    except MemoryError as error:
        print(f"error: {memory_line(error)}", file=sys.stderr)
        sys.exit(2)
    try:
        from framework.command.cli import main  # imports Hydra, but not torch
    except KeyboardInterrupt:
        print("error: interrupted", file=sys.stderr)
        sys.exit(130)
    code = main(argv)
    gc.freeze()  # freeing torch's objects one by one takes 0.7 s
    sys.exit(code)
