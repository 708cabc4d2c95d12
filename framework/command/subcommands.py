"""What the program does beside training: `fishersplat NAME ...`. A name is a word without `=`."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

from framework.command.program import program
from framework.errors import UserError, nearest_hint

# name -> (module with `main(arguments, prog) -> exit code`, what it does, in two words). One line
# each, by name. The module is light to import and reads its arguments with argparse; what it
# raises is told as for a run: see `framework.command.cli.main`.
SUBCOMMANDS = {
    "compare": ("framework.report.pair", "two runs"),
    "export": ("framework.exports.export", "for viewers"),
    "fetch": ("framework.command.fetch", "weights"),
    "leaderboard": ("framework.report.leaderboard", "all studies"),
    "render": ("framework.exports.render", "pictures"),
    "report": ("framework.report.main", "report again"),
    "search": ("framework.command.search.command", "find options"),
    "study": ("framework.command.launchers.manage", "on a cluster"),
    "video": ("framework.exports.video", "a fly-through"),
    "view": ("framework.view.main", "look at it"),
}


def asked_for(argv: Sequence[str]) -> str | None:
    """The subcommand that `argv` begins with; None for a line of options and flags.

    Raises UserError for another word.
    """
    if not argv or argv[0].startswith(("-", "+", "~")) or "=" in argv[0]:
        return None
    if argv[0] not in SUBCOMMANDS:
        raise UserError(
            f"command line: expected KEY=VALUE or a subcommand, got '{argv[0]}';"
            f" {nearest_hint(argv[0], SUBCOMMANDS)}, {program()} --help tells the rest"
        )
    return argv[0]


def obey(name: str, arguments: Sequence[str]) -> int:
    """Do a subcommand; returns the exit code."""
    code: int = importlib.import_module(SUBCOMMANDS[name][0]).main(
        list(arguments), f"{program()} {name}"
    )
    return code
