"""Writes files atomically: to a temporary file in the same folder, which is then renamed.

The content is on the disk before the rename, so that a power failure leaves the old file or the
new one. A process killed in between leaves a temporary file, which `remove_temporaries` removes.

Other processes may remove or change files of a folder that is still being written. `following`
records what was written, so that the writer can check it at the end.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from framework.errors import UserError, mendable, os_line
from framework.files.opened import is_file, open_regular

TEMPORARY = re.compile(r"\..+\.\d+\.tmp")  # as `write_whole` names them


class Unwritable(UserError):
    """A full or read-only disk, or no right to write."""

    kind = "disk"


class Written:
    """Size and SHA-256 of the files that this process writes below `folder`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._files = dict[Path, tuple[int, str]]()

    def add(self, path: Path, data: bytes) -> None:
        """Record a file, if it is below the folder."""
        if path.is_relative_to(self.folder):
            self._files[path] = len(data), hashlib.sha256(data).hexdigest()

    def listed(self) -> dict[str, tuple[int, str]]:
        """Return path within the folder -> size in bytes and SHA-256."""
        files = self._files.items()
        return {path.relative_to(self.folder).as_posix(): of for path, of in sorted(files)}


def difference(path: Path, size: int, digest: str) -> str:
    """Describe how a file differs from one of this size and SHA-256; "" if it does not."""
    if not is_file(path):
        return "nothing"
    if (now := path.stat().st_size) != size:
        return f"{now:,} bytes"
    return "other ones" if file_sha256(path) != digest else ""


_followers: list[Written] = []


@contextlib.contextmanager
def following(folder: Path) -> Iterator[Written]:
    """Record what all threads write below `folder`."""
    written = Written(folder)
    _followers.append(written)
    try:
        yield written
    finally:
        _followers.remove(written)


def write_whole(path: Path, content: bytes | str) -> None:
    """Replace `path` by `content` in one step; text is UTF-8. A reader never sees half of it.

    Raises:
        Unwritable: when the disk is full or the folder cannot be written; nothing is changed then.
    """
    data = content.encode("utf-8") if isinstance(content, str) else content
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)  # of a killed process, or a link that leads elsewhere
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        for written in tuple(_followers):
            written.add(path, data)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and mendable(error):
            raise Unwritable(os_line(error, path)) from error
        raise


def make_folder(path: Path) -> None:
    """Make `path` and what is missing above it.

    Raises:
        Unwritable: if that fails.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        if not mendable(error):
            raise
        raise Unwritable(os_line(error, path)) from error


def remove_temporaries(folder: Path, pattern: str = "**/.*.tmp") -> None:
    """Remove temporary files of killed processes in `folder` and below. No other process may be
    writing there."""
    for path in folder.glob(pattern):
        if TEMPORARY.fullmatch(path.name):
            with contextlib.suppress(OSError):
                path.unlink()


def file_sha256(path: Path) -> str:
    """SHA-256 hex of a file's content."""
    with open_regular(path, sys.maxsize) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
