"""The one exception a user meets.

Every bad input (file, option, data) is raised as `UserError` whose text says where, what was
expected, what came and how to fix it, in one line. `run.py` prints that line and exits with 2.
It derives from `ValueError`, so library callers may catch either.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UserError(ValueError):
    """Bad input, told in one line: `where: expected ..., got ...; how to fix`."""


def nearest_hint(name: str, options: Iterable[str]) -> str:
    """Text that lists `options` and, if one is close to `name`, suggests it."""
    known = sorted(options)
    close = difflib.get_close_matches(name, known, n=1)
    suggestion = f"did you mean '{close[0]}'? " if close else ""
    return f"{suggestion}available: {', '.join(known) or 'none'}"


def require(condition: bool, message: str) -> None:
    """Raise `UserError(message)` unless `condition` holds."""
    if not condition:
        raise UserError(message)
