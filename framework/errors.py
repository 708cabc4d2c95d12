"""The one exception a user meets.

Every bad input (file, option, data) is raised as `UserError` whose text says where, what was
expected, what came and, unless that says it, how to fix it, in one line. `run.py` prints that line
and exits with 2. It derives from `ValueError`, so library callers may catch either.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

LONGEST = 1000  # characters of a message


class UserError(ValueError):
    """Bad input, told in one line: `where: expected ..., got ...; how to fix`. kind: a word or two
    for tables of failures."""

    kind = "bad input"

    def __init__(self, message: str) -> None:
        super().__init__(printable_line(message))


def printable_line(text: str) -> str:
    """`text` as one line of at most `LONGEST` characters, without control characters: what a bad
    file brings along is quoted on terminals and in records."""
    line = re.sub(r"\s*\n\s*", "; ", text.strip())
    line = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in line)
    half = LONGEST // 2
    return line if len(line) <= LONGEST else f"{line[: half - 5]} ... {line[-half:]}"


def nearest_hint(name: str, options: Iterable[str]) -> str:
    """Text that lists `options` and, if one is close to `name`, suggests it."""
    known = sorted(options)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.7)
    suggestion = f"did you mean '{close[0]}'? " if close else ""
    return f"{suggestion}available: {', '.join(known) or 'none'}"


def require(condition: bool, message: str) -> None:
    """Raise `UserError(message)` unless `condition` holds."""
    if not condition:
        raise UserError(message)


def check_option(options: object, group: str, name: str, ok: bool, expected: str) -> None:
    """Raise UserError, with what `group.name` of `options` is and should be, unless `ok`."""
    got = getattr(options, name)
    told = "nothing" if got == "" else got
    require(ok, f"{group}.{name}: expected {expected}, got {told}")
