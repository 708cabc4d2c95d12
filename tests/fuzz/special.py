"""What may stand in a file's place and is no file."""

from __future__ import annotations

import os
import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np


def _socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # a socket's path has at most 107 bytes
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(path.name)
    finally:
        os.chdir(here)


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
