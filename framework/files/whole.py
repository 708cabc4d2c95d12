"""Files are written whole or not at all: beside the target first, then renamed over it.

The content is on the disk before the rename, so that a power failure leaves the old file or the
new one. A process killed in between leaves a temporary file, which `remove_temporaries` clears.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import sys
from pathlib import Path

from framework.errors import FULL, UserError, mendable
from framework.files.opened import open_regular


class Unwritable(UserError):
    """A full or read-only disk, or no right to write."""

    kind = "disk"


def write_whole(path: Path, content: bytes | str) -> None:
    """Replace `path` by `content` in one step; text is UTF-8. A reader never sees half of it.

    Raises Unwritable when the disk is full or the folder cannot be written; nothing is changed
    then.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and mendable(error):
            raise Unwritable(unwritable(error, path, len(data))) from error
        raise


def make_folder(path: Path) -> None:
    """Make `path` and what is missing above it. Raises Unwritable where that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if not mendable(error):
            raise
        raise Unwritable(unwritable(error, path)) from error


def unwritable(error: OSError, path: Path | str, n_bytes: int | None = None) -> str:
    """One line about a file that could not be written, and what to do."""
    what = "to write it"
    if n_bytes is not None:
        size = f"{n_bytes / 1e6:.1f} MB" if n_bytes >= 1e5 else f"{n_bytes:,} bytes"
        what = f"to write {size}"
    full = error.errno in FULL
    advice = "free some space" if full else "make the folder writable or choose another"
    return f"{path}: expected {what}, got '{error.strerror}'; {advice} and run the same again"


def remove_temporaries(folder: Path) -> None:
    """Remove what killed processes were writing in `folder` and below. Call it only while nobody
    else writes there."""
    for path in folder.rglob(".*.tmp"):
        with contextlib.suppress(OSError):
            path.unlink()


def file_sha256(path: Path) -> str:
    """SHA-256 hex of a file's content."""
    with open_regular(path, sys.maxsize) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
