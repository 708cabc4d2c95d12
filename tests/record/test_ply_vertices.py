"""Vertices of PLY files: text and binary of both orders, other elements, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from framework.errors import UserError
from framework.files.ply import read_commented
from tests.scenes.synthetic import write_table

KINDS = [("x", "f4"), ("y", "f8"), ("red", "u1"), ("n", "i4")]
ROWS = np.array([(0.5, -1e10, 255, -7), (1 / 3, 2.0, 0, 9)], dtype=KINDS)


@pytest.mark.parametrize(("text", "order"), [(False, "<"), (False, ">"), (True, "<")])
@pytest.mark.parametrize("count", [0, 1, 2])
def test_round_trips(tmp_path: Path, text: bool, order: str, count: int) -> None:
    write_table(tmp_path / "a.ply", ROWS[:count], text, order)
    read, _ = read_commented(tmp_path / "a.ply")
    assert read.dtype.names == ROWS.dtype.names
    for name in read.dtype.names or ():
        np.testing.assert_array_equal(read[name], ROWS[:count][name])


def ply(*lines: str, form: str = "ascii") -> bytes:
    return "\n".join(["ply", f"format {form} 1.0", *lines]).encode()


X, END = "property float x", "end_header"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"no", "expected a PLY header, got none"),
        (ply("element vertex 1", X, END, "", form="odd"), "expected format ascii or"),
        (ply("element face 0", END, ""), "expected an element 'vertex', got none"),
        (ply("element vertex 1", "property list uchar int x", END, ""), "vertices of scalars"),
        (ply("element vertex 1", "property odd x", END, ""), "'property TYPE NAME', got"),
        (ply("element vertex 99", X, END, "1"), "bytes after the header, got"),
        (ply("element vertex 2", X, END, "1", "a"), "expected the numbers that its header names"),
        (
            ply("element f 1", "property list uchar int v", "element vertex 1", X, END, "1 2", "1"),
            "expected scalars before the vertices, got the list element 'f'",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(UserError, match=message):
        read_commented(tmp_path / "a.ply")
