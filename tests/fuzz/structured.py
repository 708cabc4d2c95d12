"""Mutations that keep a format's outer shell whole, so that what lies behind it is reached: another
value in a JSON tree or a table, another array behind a right `.npy` header."""

import csv
import io
import json
import struct
from typing import Any

import numpy as np

VALUES: list[Any] = [
    *(None, True, -1, 0, 2**63, 10**400, 1e308, float("nan"), float("inf"), "", "x", "nan"),
    *([], {}, [[]], [1, 2], {"a": 1}, "../../x.png", "/etc/passwd", "a\0b", "x" * 5000, "a\nb"),
    *(1e300, -1e300, 1e15, 1e-300, "x" * 100_000, "y" * 254, "\ud800", "\udcff.png", "\x1b[2J"),
    *("$\\frac{$", "`|<b>[x](y)$_{$", "2001-01-01", " ", "\u202e", ".", "é" * 200, 2**63 - 1),
]
for _level in (20, 60, 300):  # nested lists and mappings
    _nest: Any = "x"
    for _ in range(_level):
        _nest = {"a": [_nest]}
    VALUES.append(_nest)
SHAPES = [(0,), (3, 0), (1,), (24, 32, 1), (1, 24, 32), (2, 3, 4, 5), (), (10, 17), (32, 24)]
TYPES = ["f2", "f8", "i1", "u8", "?", "c8", "U3", "S4", "M8[s]", "O", "f4,i4", ">f4", "V0"]


def structured(name: str, data: bytes, draw: np.random.Generator) -> bytes | None:
    """A mutation fit for the file called `name`; None where its format has no shell to keep."""
    if name.endswith(".json"):
        return _json(data, draw)
    if name.endswith(".csv"):
        return _csv(data, draw)
    if name.endswith(".npy"):
        return _npy(data, draw)
    return None


def _json(data: bytes, draw: np.random.Generator) -> bytes:
    tree = json.loads(data)
    node, key = tree, None
    for _ in range(int(draw.integers(1, 7))):
        keys = list(node) if isinstance(node, dict) else range(len(node))
        if not len(keys):
            break
        parent, key = node, keys[int(draw.integers(len(keys)))]
        node = parent[key]
        if not isinstance(node, (dict, list)):
            break
    if draw.random() < 0.2:
        del parent[key]
    else:
        parent[key] = VALUES[int(draw.integers(len(VALUES)))]
    return json.dumps(tree).encode("utf-8", "surrogatepass")


def _csv(data: bytes, draw: np.random.Generator) -> bytes:
    """Another value in a cell, of the heading, too, or a row or column more, less or twice."""
    rows = list(csv.reader(io.StringIO(data.decode(), newline="")))
    row = int(draw.integers(len(rows)))
    column = int(draw.integers(len(rows[row])))
    kind = draw.random()
    if kind < 0.7:
        rows[row][column] = str(VALUES[int(draw.integers(len(VALUES)))])
    elif kind < 0.8:
        rows = [[*cells[:column], *cells[column + 1 :]] for cells in rows]
    elif kind < 0.9:
        rows.insert(row, rows[row])
    else:
        rows[row] = rows[row][:column] if draw.random() < 0.5 else rows[row] * 2
    out = io.StringIO(newline="")
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue().encode("utf-8", "surrogatepass")


def _npy(data: bytes, draw: np.random.Generator) -> bytes:
    array = np.load(io.BytesIO(data), allow_pickle=False).copy()
    kind = int(draw.integers(4))
    if kind == 0 and array.size:
        flat = array.reshape(-1)
        odd = [np.nan, np.inf, -1.0, 0.0, 1e30][int(draw.integers(5))]
        flat[int(draw.integers(flat.size))] = odd
    elif kind == 1:
        array = np.ones(SHAPES[int(draw.integers(len(SHAPES)))], array.dtype)
    elif kind == 2:
        array = np.zeros(array.shape, TYPES[int(draw.integers(len(TYPES)))])
    else:
        return _huge_npy(array, draw)
    out = io.BytesIO()
    np.save(out, array, allow_pickle=True)
    return out.getvalue()


def _huge_npy(array: np.ndarray, draw: np.random.Generator) -> bytes:
    """A header that promises far more than follows."""
    side = int(draw.choice([10**5, 2**31, 2**40, 2**62]))
    shape = [(side,), (side, side), (24, 32, side), (-1, 32), (24.5, 32)][int(draw.integers(5))]
    header = {"descr": array.dtype.str, "fortran_order": False, "shape": shape}
    text = f"{header}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + array.tobytes()
