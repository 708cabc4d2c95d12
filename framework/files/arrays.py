"""Reads `.npy` and `.npz` files from strangers: plain numbers only, never pickled objects.

The header's shape is compared with the size of the file before memory is allocated; numpy's `load`
allocates whatever the header states.
"""

from __future__ import annotations

import math
import os
import zipfile
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from framework.errors import require
from framework.files.archives import open_zip
from framework.files.limits import ARRAY_BYTES
from framework.files.opened import open_regular, reading

if TYPE_CHECKING:
    from numpy.typing import NDArray

KINDS = "biuf"  # bool, integers, floating point
EXPECTED, ADVICE = "a numeric numpy array", "write it again with numpy.save or numpy.savez"


def read_npy(path: Path) -> NDArray[Any]:
    """The array of a `.npy` file.

    Raises:
        UserError: for a damaged, too large or non-numeric one.
    """
    with open_regular(path, ARRAY_BYTES) as file:
        return _array(file, os.fstat(file.fileno()).st_size, str(path))


def read_npz(path: Path, keys: list[str], most_bytes: int = ARRAY_BYTES) -> list[NDArray[Any]]:
    """The arrays named `keys` of a `.npz` file.

    Raises:
        UserError: as `read_npy`, or when one is missing; `most_bytes` is for all members of the
            file together.
    """
    with open_zip(path, most_bytes) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
        missing = [key for key in keys if key not in names]
        require(
            not missing,
            f"{path}: expected {_few(keys)}, got {_few(names)}; {len(missing)} missing (first:"
            f" {missing[0] if missing else ''}), write them with numpy.savez(file, name=array)",
        )
        return [_member(archive, f"{key}.npy", path) for key in keys]


def _few(names: list[str]) -> str:
    """The first names of a list that may be long."""
    shown = ", ".join(repr(name[:40]) for name in names[:4]) or "nothing"
    return shown + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _member(archive: zipfile.ZipFile, name: str, path: Path) -> NDArray[Any]:
    where = f"{path}: {name.removesuffix('.npy')}"
    with reading(where, EXPECTED, ADVICE):
        info = archive.getinfo(name)
        with archive.open(info) as stream:
            array = _array(stream, info.file_size, where)
    return array


def _array(stream: IO[bytes], size: int, where: str) -> NDArray[Any]:
    """The array that the stream holds, the whole being `size` bytes."""
    from numpy.lib import format as npy

    shape, dtype, start = _header(stream, where)
    require(
        dtype.kind in KINDS and dtype.subdtype is None,
        f"{where}: expected numbers, got type {str(dtype)[:60]}; save it as float32",
    )
    expected = start + math.prod(shape) * dtype.itemsize
    require(
        expected == size and size - start <= ARRAY_BYTES,
        f"{where}: expected {expected:,} bytes for shape {str(shape)[:80]} {dtype}, got {size:,}"
        f" (at most {ARRAY_BYTES:,}); the file is damaged or too large, write it again",
    )
    stream.seek(0)
    with reading(where, EXPECTED, ADVICE):
        array = npy.read_array(stream, allow_pickle=False)
    return array


def _header(stream: IO[bytes], where: str) -> tuple[tuple[int, ...], Any, int]:
    """(shape, dtype, bytes of the header)."""
    from numpy.lib import format as npy

    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    with reading(where, EXPECTED, ADVICE):
        version = npy.read_magic(stream)
        if version not in readers:
            raise ValueError(f"version {version}")
        shape, _, dtype = readers[version](stream)
        start = stream.tell()
    require(
        all(type(n) is int and n >= 0 for n in shape),
        f"{where}: expected a shape of integers >= 0, got {str(shape)[:80]}; write it again",
    )
    return shape, dtype, start
