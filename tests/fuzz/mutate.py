"""Mutations of a file's bytes, and what may be in a file's place and is no file."""

import os
import re
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tests.fuzz.structured import structured

HUGE = [
    *(2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1, 0, 1),
    *(10**6, 10**9, 10**12),
]
WORDS = [
    *(b"nan", b"-inf", b"1e999", b"-1", b"0", b"4294967296", b"99999999999999999999", b"9" * 5000),
    *(b"", b"null", b"[]", b"{}", b'"x"', b"true", b"../../x", b"/etc/passwd", b"\0", b"\xff\xfe"),
    *(b"1e300", b"-1e300", b"1e-300", b"0.0", b"\xed\xa0\x80", b"x" * 70_000),
    *(b"$\\frac{$", b"`|<b>"),
    *(b"*a", b"[" * 3000, b"[" * 100_000, b"1" * 400 + b".5", b"0x10", b"1_000", "٣".encode()),
]
Mutation = Callable[[bytes, np.random.Generator], bytes]


def mutate(name: str, data: bytes, draw: np.random.Generator) -> bytes:
    """One to three mutations of the file `name` with `data`."""
    if draw.random() < 0.5:
        changed = structured(name, data, draw)
        if changed is not None:
            return changed
    usual = WRITTEN if name.endswith(TEXTS) and draw.random() < 0.8 else MUTATIONS
    for _ in range(1 if draw.random() < 0.6 else int(draw.integers(2, 4))):
        data = usual[int(draw.integers(len(usual)))](data, draw)
    return data


def _at(data: bytes, draw: np.random.Generator) -> int:
    """A place in the data; every fourth time near its start, where headers are."""
    size = max(len(data), 1)
    return int(draw.integers(min(size, 96) if draw.random() < 0.25 else size))


def _cut(data: bytes, draw: np.random.Generator) -> bytes:
    return data[: _at(data, draw)]


def _flip(data: bytes, draw: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(draw.integers(1, 9))):
        if out:
            out[_at(data, draw)] ^= 1 << int(draw.integers(8))
    return bytes(out)


def _insert(data: bytes, draw: np.random.Generator) -> bytes:
    at = _at(data, draw)
    return data[:at] + draw.bytes(int(draw.integers(1, 40))) + data[at:]


def _delete(data: bytes, draw: np.random.Generator) -> bytes:
    at = _at(data, draw)
    return data[:at] + data[at + int(draw.integers(1, 40)) :]


def _count(data: bytes, draw: np.random.Generator) -> bytes:
    """A huge or odd integer over 4 or 8 bytes."""
    width = int(draw.choice([4, 8]))
    value = HUGE[int(draw.integers(len(HUGE)))] % (1 << 8 * width)
    order = "little" if draw.random() < 0.7 else "big"
    at = _at(data, draw)
    return data[:at] + value.to_bytes(width, order) + data[at + width :]


def _number(data: bytes, draw: np.random.Generator) -> bytes:
    """Another word in place of a number that is written out."""
    return _replace(rb"-?\d+\.?\d*(?:e[+-]?\d+)?", data, draw)


def _word(data: bytes, draw: np.random.Generator) -> bytes:
    return _replace(rb"[A-Za-z_][\w./]*", data, draw)


def _replace(pattern: bytes, data: bytes, draw: np.random.Generator) -> bytes:
    actual = list(re.finditer(pattern, data[:200_000]))
    if not actual:
        return data
    match = actual[int(draw.integers(len(actual)))]
    word = WORDS[int(draw.integers(len(WORDS)))]
    return data[: match.start()] + word + data[match.end() :]


def _floats(data: bytes, draw: np.random.Generator) -> bytes:
    """NaN, infinity or a huge number over 4 or 8 bytes."""
    value = [np.nan, np.inf, -np.inf, 1e300, -0.0][int(draw.integers(5))]
    with np.errstate(over="ignore"):
        word = np.array(value, "<f4" if draw.random() < 0.5 else "<f8").tobytes()
    at = _at(data, draw)
    return data[:at] + word + data[at + len(word) :]


WRITTEN: tuple[Mutation, ...] = (_cut, _delete, _number, _number, _word)
MUTATIONS: tuple[Mutation, ...] = (
    *(_cut, _flip, _flip, _insert, _delete, _count, _count, _number, _word, _floats, _floats),
)
TEXTS = (".txt", ".csv", ".json", ".ply", ".line")


def _socket(path: Path) -> None:
    inner = Path.cwd()
    os.chdir(path.parent)  # a socket's path has at most 107 bytes
    try:
        with socket.socket(socket.AF_UNIX) as built:
            built.bind(path.name)
    finally:
        os.chdir(inner)


PUT: tuple[Callable[[Path], object], ...] = (
    os.mkfifo,
    Path.mkdir,
    _socket,
    lambda path: path.symlink_to("/dev/zero"),
    lambda path: path.symlink_to("/dev/tty"),
    lambda path: path.symlink_to(path.name),  # to itself
    lambda path: path.symlink_to("nothing"),
    lambda path: path.symlink_to("x" * 300),
    lambda path: path.symlink_to("/proc/self/mem"),
    lambda path: path.symlink_to("."),
    lambda path: None,  # nothing at all
)


def put_special(path: Path, draw: np.random.Generator) -> None:
    """Replace the file by one of `PUT`."""
    path.unlink()
    PUT[int(draw.integers(len(PUT)))](path)


def put_back(path: Path, data: bytes) -> None:
    """Replace whatever is there by a file with this content."""
    if os.path.isdir(path) and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    path.write_bytes(data)
