"""Whether a PLY file can hold what its header promises, before a library allocates for it.

For files that a general reader (`plyfile`) reads: elements with scalar and list properties, text or
binary. A record takes at least one byte per list and the size of each scalar; as text, two.
"""

from __future__ import annotations

import re
from pathlib import Path

from framework.errors import UserError, require
from framework.files.limits import PLY_BYTES, check_size

HEADER_BYTES = 65536
SIZES = {
    **dict.fromkeys(("char", "uchar", "int8", "uint8"), 1),
    **dict.fromkeys(("short", "ushort", "int16", "uint16"), 2),
    **dict.fromkeys(("int", "uint", "int32", "uint32", "float", "float32"), 4),
    **dict.fromkeys(("double", "float64"), 8),
}
COUNT = re.compile(r"\d{1,15}", re.ASCII)


def check_counts(path: Path) -> None:
    """Raise UserError unless the file is large enough for the elements of its header, and within
    the limit."""
    size = check_size(path, PLY_BYTES)
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
    end = re.search(rb"^end_header\r?\n", head, re.MULTILINE)
    if not head.startswith(b"ply") or end is None:
        raise UserError(f"{path}: expected a PLY header, got none; it is no PLY file")
    lines = head[: end.start()].decode("ascii", errors="replace").splitlines()
    least = _least_bytes(lines, path)
    require(
        least <= size - end.end(),
        f"{path}: expected at least {least:,} bytes after the header, got {size - end.end():,}; the"
        " file is damaged, write it again",
    )


def _least_bytes(lines: list[str], path: Path) -> int:
    text = any(line.split()[:2] == ["format", "ascii"] for line in lines)
    total = count = width = 0
    for line in lines:
        match line.split():
            case ["element", _, number] if COUNT.fullmatch(number):
                total += count * max(width, 1)
                count, width = int(number), 0
            case ["property", "list", *_]:
                width += 2 if text else 1
            case ["property", kind, _] if kind in SIZES:
                width += 2 if text else SIZES[kind]
            case ["element" | "property", *_]:
                raise UserError(
                    f"{path}: expected 'element NAME COUNT' and 'property TYPE NAME', got"
                    f" '{line[:60]}'; write the file again"
                )
    # the last line of a text file may lack its end
    return total + count * max(width, 1) - (1 if text else 0)
