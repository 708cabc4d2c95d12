"""Subcommands' arguments: argparse, whose complaints are one line like all others."""

from __future__ import annotations

import argparse
import re
from typing import NoReturn

from framework.errors import UserError

REWORDED = (  # argparse's words -> ours
    (r"the following arguments are required: (.*)", r"expected \1, got none"),
    (r"argument ([^:]+): invalid choice: (.*) \(choose from (.*)\)", r"\1: expected \3, got \2"),
    (r"argument ([^:]+): invalid int value: (.*)", r"\1: expected an integer, got \2"),
    (r"argument ([^:]+): invalid float value: (.*)", r"\1: expected a number, got \2"),
    (r"argument ([^:]+): expected (.*)", r"\1: expected \2, got something else"),
    (r"argument ([^:]+): (.*)", r"\1: \2"),
    (r"unrecognized arguments: (.*)", r"expected only what the usage names, got \1"),
)


class Arguments(argparse.ArgumentParser):
    """Raises UserError for arguments that it refuses, with the usage as the way to mend them."""

    def error(self, message: str) -> NoReturn:
        for theirs, ours in REWORDED:
            found, count = re.subn(f"^{theirs}$", ours, message)
            if count:
                message = found
                break
        usage = " ".join(self.format_usage().split())
        raise UserError(f"{self.prog}: {message}; {usage}")
