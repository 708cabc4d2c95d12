"""The vertices of a PLY file (Turk 1994): a header, then the elements it names, as text or binary.

Only files of points are read: one element `vertex` of scalar properties, and only scalars before
it. The header is checked against the file's size before anything is allocated.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require
from framework.files.limits import PLY_BYTES
from framework.files.opened import open_regular, reading

HEADER_BYTES = 65536
KINDS = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1"},
    **{"short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2"},
    **{"int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
COUNT = re.compile(r"\d{1,15}", re.ASCII)


@dataclass(frozen=True)
class _Header:
    """begin: of the body, in bytes. before: rows (text) or bytes before the vertices."""

    comments: list[list[str]]
    begin: int
    before: int
    count: int
    dtype: np.dtype[Any]
    text: bool


def read_commented(path: Path) -> tuple[NDArray[Any], list[list[str]]]:
    """[count] structured array of the vertices, and the words of the comments.

    Raises:
        UserError: for a file without vertices.
    """
    with open_regular(path, PLY_BYTES) as file:
        size, header = os.fstat(file.fileno()).st_size, _header(path, file.read(HEADER_BYTES))
        # a value in text takes a digit and a separator, except for the very last one
        row = 2 * len(header.dtype.names or ()) if header.text else header.dtype.itemsize
        least = header.before + header.count * row - header.text
        require(
            least <= size - header.begin,
            f"{path}: expected at least {least:,} bytes after the header, got"
            f" {size - header.begin:,}; the file is damaged, write it again",
        )
        if header.text:
            file.seek(header.begin)
            return _text_rows(path, header, file.read()), header.comments
        file.seek(header.begin + header.before)
        return np.fromfile(file, header.dtype, header.count), header.comments


def _text_rows(path: Path, header: _Header, body: bytes) -> NDArray[Any]:
    with reading(path, "the numbers that its header names"):
        lines = body.decode("ascii").splitlines()[header.before :][: header.count]
        rows = np.empty(0, header.dtype)
        if lines:
            rows = np.loadtxt(lines, header.dtype, comments=None, ndmin=1)
    require(
        len(rows) == header.count,
        f"{path}: expected {header.count:,} vertices, got {len(rows):,}; the file is damaged, write"
        " it again",
    )
    return rows


def _header(path: Path, head: bytes) -> _Header:
    end = re.search(rb"^end_header\r?\n", head, re.MULTILINE)
    if not head.startswith(b"ply") or end is None:
        raise UserError(f"{path}: expected a PLY header, got none; it is no PLY file")
    lines = [line.split() for line in head[: end.start()].decode("ascii", "replace").splitlines()]
    form = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "")
    require(
        form in ORDERS, f"{path}: expected format {' or '.join(ORDERS)}, got '{form[:40]}'; convert"
    )
    order, before = ORDERS[form], 0
    for name, count, properties in _elements(path, lines):
        kinds = [(p, kind if order is None else order + kind) for p, kind in properties or []]
        dtype = np.dtype(kinds)
        if name == "vertex":
            require(
                bool(dtype.names), f"{path}: expected vertices of scalars, got lists or nothing"
            )
            comments = [words[1:] for words in lines if words[:1] == ["comment"]]
            return _Header(comments, end.end(), before, count, dtype, order is None)
        require(
            bool(dtype.names) or count == 0,
            f"{path}: expected scalars before the vertices, got the list element '{name[:40]}';"
            " write the vertices first",
        )
        before += count if order is None else count * dtype.itemsize
    raise UserError(f"{path}: expected an element 'vertex', got none; it holds no points")


Element = tuple[str, int, list[tuple[str, str]] | None]


def _elements(path: Path, lines: list[list[str]]) -> list[Element]:
    """Name, count and scalar properties of every element; None if it has a list."""
    elements: list[Element] = []
    for words in lines:
        name, count, properties = elements[-1] if elements else ("", 0, [])
        match words:
            case ["element", name, number] if COUNT.fullmatch(number):
                elements.append((name, int(number), []))
            case ["property", "list", *_] if elements:
                elements[-1] = (name, count, None)
            case ["property", kind, added] if kind in KINDS and elements:
                require(
                    added not in dict(properties or []),
                    f"{path}: expected each property once, got two '{added}'",
                )
                if properties is not None:
                    properties.append((added, KINDS[kind]))
            case ["element" | "property", *_]:
                raise UserError(
                    f"{path}: expected 'element NAME COUNT' and 'property TYPE NAME', got"
                    f" '{' '.join(words)[:60]}'; write the file again"
                )
    return elements
