"""Opens files from strangers; all readers of such files use it.

Only regular files are opened, also through links: a pipe would block its reader, and a device has
no end. A file is never read beyond its limit. Errors of the system about a path (too long, circular
links, no permission) become a UserError.
"""

from __future__ import annotations

import codecs
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path

from framework.errors import UserError, machine_line, mendable, os_line, require

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def open_regular(path: Path, limit: int) -> BufferedReader:
    """The file, opened for reading its bytes.

    Raises:
        UserError: unless it is a regular one of at most `limit` bytes; OSError where the machine
            has no memory or handles left.
    """
    file_size(path, limit)  # before it is opened: to open a device may do something
    try:
        # should it have become a pipe since, it does not wait for a writer
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise _user_error(error, path) from None
    file = os.fdopen(descriptor, "rb")
    try:
        _check(os.fstat(descriptor), path, limit)
        file.peek(1)  # whether it can be read: /proc has regular files that cannot
    except UserError:
        file.close()
        raise
    except OSError as error:
        file.close()
        raise UserError(os_line(error, path)) from None
    return file


def read_bytes(path: Path, limit: int) -> bytes:
    """The content. Raises as `open_regular`, and UserError for one that cannot be read."""
    with open_regular(path, limit) as file:
        # not `limit`: Python reserves what it is asked to read
        size = min(limit, os.fstat(file.fileno()).st_size)
        try:
            return file.read(size)
        except OSError as error:  # a damaged disk
            raise _user_error(error, path) from None


def read_text(path: Path, limit: int) -> str:
    """Read UTF-8 text, or UTF-16 with a byte order mark as PowerShell writes it. The mark is
    removed; line ends are kept. Raises as `read_bytes`, and UserError for another encoding."""
    data = read_bytes(path, limit)
    utf16 = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        return data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{path}: expected text in UTF-8, got byte {error.object[error.start]:#04x} at"
            f" {error.start}; save it as UTF-8 or write it again"
        ) from None


@contextmanager
def reading(where: object, expected: str, advice: str = "write it again") -> Iterator[None]:
    """Turn what a parser of a stranger's file raises into a UserError that names the file.

    Parsers raise nearly everything: numpy's reads Python text, so tokenizer, recursion and unicode
    errors come out of it (`tests/system/test_fuzz.py`). Errors of the machine, as a lack of memory,
    stay what they are.
    """
    try:
        yield
    except Exception as error:
        if isinstance(error, UserError) or machine_line(error) is not None:
            raise
        reason = " ".join(str(error).split())[:160]  # in one line
        got = f"{type(error).__name__}: {reason}".rstrip(": ")
        raise UserError(
            f"{where}: expected {expected}, got a damaged one ({got}); {advice}"
        ) from error


def file_size(path: Path, limit: int) -> int:
    """The size of the file in bytes.

    Raises:
        UserError: unless it is a regular one of at most `limit` bytes: the check for libraries that
            open a file by its name.
    """
    try:
        return _check(os.stat(path), path, limit)
    except OSError as error:
        raise _user_error(error, path) from None
    except ValueError as error:  # half a character, or a zero, in its name
        if isinstance(error, UserError):
            raise
        raise UserError(f"{path}: expected a file's name, got none ({error}); correct it") from None


def is_file(path: Path) -> bool:
    """Whether there is a regular file; False for a name that no file can have."""
    return os.path.isfile(path)


def _check(status: os.stat_result, path: Path, limit: int) -> int:
    kind = KINDS.get(stat.S_IFMT(status.st_mode), "something else")
    require(
        stat.S_ISREG(status.st_mode),
        f"{path}: expected a regular file, got {kind}; put a file in its place",
    )
    require(
        status.st_size <= limit,
        f"{path}: expected a file of at most {limit:,} bytes, got {status.st_size:,}; use a smaller"
        " one (the limits are in framework/files/limits.py)",
    )
    return status.st_size


def _user_error(error: OSError, path: Path) -> OSError | UserError:
    return UserError(os_line(error, path)) if mendable(error) else error
