"""UserError, the exception for bad input, and what turns other errors into one line.

Every bad input (file, option, data) is raised as `UserError`. Its text says in one line where, what
was expected, what came, and how to fix it. `run.py` prints that line and exits with 2. It derives
from `ValueError`, so library callers may catch either.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import os
import re
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

HERE, STDLIB = (re.escape(os.path.dirname(module)) for module in (__file__, os.__file__))
NOT_A_PLUGIN = rf"<|{HERE}/|{STDLIB}/(?!(site|dist)-packages/)"  # files in a traceback
LONGEST = 1000  # characters of a message
FULL = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
MEDIUM = FULL | {errno.EIO, errno.EROFS}  # errors of writing that do not name the file
# what the machine has too little of, whatever the path
EXHAUSTED = frozenset((errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN))
NOWHERE = "results or cache (FISHERSPLAT_CACHE)"  # of an error without a file
NO_MEMORY = (  # messages of libraries
    *("can't allocate memory", "can't start new thread", "failed to map segment"),
    *("cannot allocate memory", "insufficient memory", "bad_alloc"),
)


class UserError(ValueError):
    """Bad input: `where: expected ..., got ...; how to fix`. kind: a word or two for tables of
    failures.
    """

    kind = "bad input"

    def __init__(self, message: str) -> None:
        super().__init__(printable_line(message))


class PluginError(UserError):
    """A mistake in a plugin."""

    kind = "plugin"


@contextmanager
def plugin_call(where: str, advice: str = "fix the plugin") -> Iterator[None]:
    """Turn whatever a plugin raises, `sys.exit` too, into one line that names it.

    UserError and errors of the machine pass unchanged.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, UserError) or machine_line(error) is not None:
            raise
        what = f"raised {type(error).__name__}: {error}".rstrip(": ")
        if isinstance(error, SystemExit):
            what = f"called sys.exit({'' if error.code is None else repr(error.code)})"
        frames = traceback.extract_tb(error.__traceback__)
        outside = [f for f in frames if not re.match(NOT_A_PLUGIN, f.filename)]
        place = f" ({Path(outside[0].filename).name}:{outside[0].lineno})" if outside else ""
        raise PluginError(
            f"{where}: {what}{place}; {advice} (traceback=true shows the calls)"
        ) from error


def printable_line(text: str) -> str:
    """`text` as one line of at most `LONGEST` characters, without control characters: what a bad
    file brings along is quoted on terminals and in records."""
    line = re.sub(r"\s*\n\s*", "; ", text.strip())
    line = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in line)
    half = LONGEST // 2
    return line if len(line) <= LONGEST else f"{line[: half - 5]} ... {line[-half:]}"


def nearest_hint(name: str, options: Iterable[str]) -> str:
    """Text that lists `options` and, if one is close to `name`, suggests it."""
    available = sorted(options)
    close = difflib.get_close_matches(name, available, n=1, cutoff=0.7)
    suggestion = f"did you mean '{close[0]}'? " if close else ""
    return f"{suggestion}available: {', '.join(available) or 'none'}"


def require(condition: bool, message: str) -> None:
    """Raise `UserError(message)` unless `condition` holds."""
    if not condition:
        raise UserError(message)


def check_option(options: object, group: str, name: str, ok: bool, expected: str) -> None:
    """Raise UserError, with what `group.name` of `options` is and should be, unless `ok`."""
    got = getattr(options, name)
    shown = "nothing" if got == "" else got
    require(ok, f"{group}.{name}: expected {expected}, got {shown}")


def mendable(error: OSError) -> bool:
    """Whether the user can fix it: no space, or a problem with the path that it names."""
    about_path = error.filename is not None and error.errno not in EXHAUSTED
    return error.errno in MEDIUM or (about_path and not isinstance(error, ConnectionError))


def os_line(error: OSError, path: Path | str | None = None) -> str:
    """Format an OS error in one line, for `path` or the path in the error."""
    where = path if path is not None else error.filename or NOWHERE
    if isinstance(where, bytes):
        where = where.decode("utf-8", "replace")
    if error.errno == errno.ENOENT:
        problem = "expected a file or folder, found none"
        return f"{where}: {problem}; correct the path, or choose a place that takes new ones"
    if error.errno == errno.EEXIST:
        return f"{where}: expected a folder or nothing yet, got a file; choose another place"
    expected = "what may be opened"
    if error.errno in FULL:
        expected, advice = "room to write", "free some space"
    elif error.errno in (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR):
        advice = "correct the path"
    else:
        advice = "change its rights or choose another"
    return f"{where}: expected {expected}, got '{error.strerror}'; {advice}, and run the same again"


def out_of_memory(error: BaseException) -> bool:
    """Whether an error of any library means that memory or threads are exhausted."""
    text = str(error).lower()
    typical = isinstance(error, RuntimeError | ImportError | OSError)
    return isinstance(error, MemoryError) or (typical and any(word in text for word in NO_MEMORY))


def memory_line(error: BaseException) -> str:
    """Format a lack of memory in one line."""
    reason = printable_line(str(error))[:160] or type(error).__name__
    return (
        f"memory: expected room for the run, got '{reason}'; free some, raise the limit"
        " (ulimit -v), or choose a smaller scene, a higher scene.downscale, a lower init.budget"
    )


def machine_line(error: BaseException) -> str | None:
    """Format an error about a file, disk space or memory in one line; None for other errors."""
    if isinstance(error, OSError) and mendable(error):
        return printable_line(os_line(error))
    return printable_line(memory_line(error)) if out_of_memory(error) else None


class Arguments(argparse.ArgumentParser):
    """Raises UserError for arguments that it refuses, and shows the usage."""

    def error(self, message: str) -> NoReturn:
        usage = " ".join(self.format_usage().split())
        raise UserError(f"{self.prog}: {message}; {usage}")
