"""Subcommands, `fishersplat NAME ...`: a first word without `=` is a subcommand."""

from __future__ import annotations

import importlib
from collections.abc import Sequence

from framework.errors import UserError, nearest_hint
from framework.files.program import program

# name -> (module with `main(arguments, prog) -> exit code`, what it does in two words). The modules
# are light to import and use argparse; `framework.command.cli.main` prints what they raise.
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


def subcommand_of(argv: Sequence[str]) -> str | None:
    """Return the subcommand that `argv` begins with; None if it begins with an option or flag.

    Raises:
        UserError: for another word.
    """
    if not argv or argv[0].startswith(("-", "+", "~")) or "=" in argv[0]:
        return None
    if argv[0] not in SUBCOMMANDS:
        raise UserError(
            f"command line: expected KEY=VALUE or a subcommand, got '{argv[0]}';"
            f" {nearest_hint(argv[0], SUBCOMMANDS)}, {program()} --help lists the rest"
        )
    return argv[0]


def run_subcommand(name: str, arguments: Sequence[str]) -> int:
    """Run a subcommand; returns the exit code."""
    code: int = importlib.import_module(SUBCOMMANDS[name][0]).main(
        list(arguments), f"{program()} {name}"
    )
    return code
