"""Opens zip archives from strangers (`.npz`, PyTorch weights) within limits.

The sizes of the table of contents and of the unpacked members are read before memory is allocated
for them. Python's `zipfile` never unpacks more than the stated size of a member.
"""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path
from typing import BinaryIO

from framework.errors import UserError, require
from framework.files.limits import MIB
from framework.files.opened import open_regular, reading

CONTENTS_BYTES = MIB  # of an archive's table of contents: about ten thousand members
TAIL_BYTES = 22 + 65535  # the closing record with the longest comment
CLOSING, LOCATOR, CLOSING_64 = b"PK\5\6", b"PK\6\7", b"PK\6\6"


def open_zip(path: Path, unpacked_bytes: int) -> zipfile.ZipFile:
    """Open an archive.

    Raises:
        UserError: for a damaged one, or if its file, table of contents or unpacked content is too
            large.
    """
    with open_regular(path, unpacked_bytes) as file:
        contents = _contents_bytes(file)
    require(
        contents <= CONTENTS_BYTES,
        f"{path}: expected a table of contents of at most {CONTENTS_BYTES:,} bytes, got"
        f" {contents:,}; pack fewer files",
    )
    with reading(path, "a zip archive"):
        archive = zipfile.ZipFile(path)
    unpacked = sum(member.file_size for member in archive.infolist())
    if unpacked > unpacked_bytes:
        archive.close()
        raise UserError(
            f"{path}: expected at most {unpacked_bytes:,} bytes when unpacked, got {unpacked:,};"
            " use smaller arrays (the limits are in framework/files/limits.py)"
        )
    return archive


def _contents_bytes(file: BinaryIO) -> int:
    """The size of the table of contents that the archive's closing record states (PKWARE
    APPNOTE 4.3.14 to 4.3.16); 0 without such a record, which `zipfile` refuses."""
    size = file.seek(0, 2)
    file.seek(max(0, size - TAIL_BYTES - 76))
    tail = file.read()
    at = tail.rfind(CLOSING)
    if at < 0 or at + 22 > len(tail):
        return 0
    stated = int(struct.unpack_from("<L", tail, at + 12)[0])
    record = at - 76
    if record >= 0 and tail[at - 20 : at - 16] == LOCATOR and tail[record:].startswith(CLOSING_64):
        stated = max(stated, int(struct.unpack_from("<Q", tail, record + 40)[0]))
    return stated
