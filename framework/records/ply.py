"""Gaussians in the PLY layout of 3DGS (Kerbl et al. 2023), which splat viewers open.

Binary little endian, one element `vertex`, all properties float32: `x y z nx ny nz f_dc_0..2
f_rest_* opacity scale_0..2 rot_0..3`. Stored are the unactivated parameters: logits, log-scales,
wxyz quaternions. `f_rest` is channel-major: all coefficients of red, then of green, then of blue.
The header comment `background r g b` holds the colour the Gaussians were trained against.

If only the first M of the N Gaussians have SH bands above 0, the PLY has none and the comment
`bands M`; `shN` [M, K-1, 3] is in `NAME_sh.npy` next to `NAME.ply`. In a PLY all vertices have the
same properties, and viewers do not read a second element.
"""

from __future__ import annotations

import io
import math
import os
import re
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from framework.errors import UserError, require
from framework.files.limits import PLY_BYTES
from framework.files.opened import is_file, open_regular
from framework.files.whole import write_whole

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

HEADER_LIMIT = 65536  # bytes; no splat header is near it, a file that is no PLY soon is
COUNT = re.compile(r"\d{1,15}", re.ASCII)
FLOAT_NAMES = ("float", "float32")
NORMALS = {"nx", "ny", "nz"}  # written for viewers that expect them, but without a meaning
BANDS_SHAPES = ((3, 3), (8, 3), (15, 3))  # K - 1 coefficients above degree 0, channels
REST_COUNTS = {0: 0, 9: 3, 24: 8, 45: 15}  # number of f_rest properties -> coefficients per channel


def property_names(rest: int) -> list[str]:
    """The property names in order, with `rest` higher SH coefficients per channel."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(3 * rest)),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def write_ply(path: Path, gaussians: Gaussians, background: Tensor) -> int:
    """Write `gaussians` (as float32) and `background` [3]; returns the size in bytes, with that of
    the file of SH bands, which is written or removed."""
    n, banded, bands_file = len(gaussians), len(gaussians.shN), bands_path(path)
    mixed = gaussians.sh_degree > 0 and banded < n
    rest = gaussians.shN.shape[1] if banded == n else 0
    table = _to_table(gaussians, rest)
    red, green, blue = (repr(float(c)) for c in background.detach().cpu())
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment background {red} {green} {blue}",
        *([f"comment bands {banded}"] if mixed else []),
        f"element vertex {n}",
        *(f"property float {name}" for name in property_names(rest)),
        "end_header",
    ]
    content = "\n".join(header).encode("ascii") + b"\n" + table.tobytes()
    bands = _npy(gaussians.shN) if mixed else b""
    if mixed:
        write_whole(bands_file, bands)
    else:
        bands_file.unlink(missing_ok=True)
    write_whole(path, content)
    return len(content) + len(bands)


def bands_path(path: Path) -> Path:
    """The file of SH bands beside a PLY, where only some Gaussians have any."""
    return path.with_name(f"{path.stem}_sh.npy")


def _npy(bands: Tensor) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, bands.detach().cpu().numpy().astype("<f4"), allow_pickle=False)
    return buffer.getvalue()


@dataclass(frozen=True)
class Splats:
    """The content of a PLY, as float32 arrays named as in `framework.types.Gaussians`.

    Attributes:
        means: [N, 3]; quats: [N, 4]; log_scales: [N, 3]; opacity_logits: [N].
        sh0: [N, 1, 3]; shN: [M, K-1, 3].
        background: red, green, blue; None if the file lacks it.
    """

    means: np.ndarray
    quats: np.ndarray
    log_scales: np.ndarray
    opacity_logits: np.ndarray
    sh0: np.ndarray
    shN: np.ndarray
    background: list[float] | None


def read_ply(path: Path) -> tuple[Gaussians, Tensor | None]:
    """The Gaussians (float32) and the background [3], None if the file lacks it.

    Raises as `read_splats`.
    """
    import torch

    from framework.types import Gaussians

    splats = read_splats(path)
    tensors = {
        field.name: torch.from_numpy(getattr(splats, field.name))
        for field in fields(splats)
        if field.name != "background"
    }
    background = splats.background
    return Gaussians(**tensors), None if background is None else torch.tensor(background)


def read_splats(path: Path) -> Splats:
    """The content as arrays, without torch.

    Raises:
        UserError: when the file is missing, is no splat PLY, is too large, its size contradicts its
            header, or it holds NaN or infinity.
    """
    with open_regular(path, PLY_BYTES) as file:
        header = _read_header(file, path)
        rest = _rest_count(header.names, path)
        expected = file.tell() + 4 * header.count * len(header.names)
        size = os.fstat(file.fileno()).st_size
        require(
            size == expected,
            f"{path}: expected {expected} bytes for {header.count} vertices, got {size};"
            " the file is damaged, write it again",
        )
        raw = np.fromfile(file, dtype="<f4").reshape(header.count, len(header.names))
    columns = {name: index for index, name in enumerate(header.names)}
    used = [columns[name] for name in property_names(rest) if name not in NORMALS]
    bad = np.flatnonzero(~np.isfinite(raw[:, used]).all(axis=1))
    require(
        not len(bad),
        f"{path}: expected finite parameters, got NaN or infinity in {len(bad)} vertices (first:"
        f" {bad[0] if len(bad) else ''}); remove them or export the model again",
    )
    splats = replace(_from_table(raw, columns, rest), background=header.background)
    return replace(splats, shN=_read_bands(path, header)) if header.banded else splats


def _read_bands(path: Path, header: _Header) -> np.ndarray:
    """Read [M, K-1, 3] from the file that the header of `path` names."""
    from framework.files.arrays import read_npy

    bands_file, m = bands_path(path), header.banded
    require(
        not any(name.startswith("f_rest_") for name in header.names) and 0 < m < header.count,
        f"{path}: expected 'comment bands M' with 0 < M < {header.count} and no f_rest properties,"
        f" got M = {m}; the header is damaged, write the file again",
    )
    require(is_file(bands_file), f"{bands_file}: expected the SH bands of {path.name}, found none")
    bands = read_npy(bands_file)
    fits = bands.ndim == 3 and bands.shape[0] == m and bands.shape[1:] in BANDS_SHAPES
    require(
        bool(fits and np.isfinite(bands).all()),
        f"{bands_file}: expected finite numbers of shape [{m}, 3, 8 or 15, 3], got"
        f" {list(bands.shape)}; write {path.name} again",
    )
    return np.ascontiguousarray(bands, dtype=np.float32)


def _to_table(gaussians: Gaussians, rest: int) -> np.ndarray:
    """[N, P] little-endian float32, columns as `property_names(rest)`."""
    g = {name: t.detach().cpu().numpy().astype("<f4") for name, t in gaussians.items()}
    n = len(gaussians)
    parts = [g["means"], np.zeros((n, 3), "<f4"), g["sh0"].reshape(n, 3)]
    if rest:
        parts.append(g["shN"].transpose(0, 2, 1).reshape(n, 3 * rest))
    parts += [g["opacity_logits"].reshape(n, 1), g["log_scales"], g["quats"]]
    return np.ascontiguousarray(np.concatenate(parts, axis=1))


def _from_table(raw: np.ndarray, columns: dict[str, int], rest: int) -> Splats:
    def take(*names: str) -> np.ndarray:
        return raw[:, [columns[name] for name in names]].astype(np.float32, order="C")

    n = len(raw)
    bands = take(*(f"f_rest_{i}" for i in range(3 * rest))).reshape(n, 3, rest)
    return Splats(
        means=take("x", "y", "z"),
        quats=take(*(f"rot_{i}" for i in range(4))),
        log_scales=take(*(f"scale_{i}" for i in range(3))),
        opacity_logits=take("opacity").reshape(n),
        sh0=take(*(f"f_dc_{i}" for i in range(3))).reshape(n, 1, 3),
        shN=np.ascontiguousarray(bands.transpose(0, 2, 1)),
        background=None,
    )


def _rest_count(names: tuple[str, ...], path: Path) -> int:
    """Higher SH coefficients per channel of a file with these properties."""
    n_rest = sum(name.startswith("f_rest_") for name in names)
    require(
        n_rest in REST_COUNTS,
        f"{path}: expected 0, 9, 24 or 45 f_rest properties (SH degree 0 to 3), got {n_rest};"
        " export it again with a degree up to 3",
    )
    absent = set(property_names(REST_COUNTS[n_rest])) - NORMALS - set(names)
    require(
        not absent,
        f"{path}: expected the 3DGS properties, got none named {', '.join(sorted(absent)[:4])};"
        " this is not a Gaussian splat file",
    )
    return REST_COUNTS[n_rest]


@dataclass(frozen=True)
class _Header:
    count: int
    names: tuple[str, ...]
    background: list[float] | None
    banded: int


def _read_header(file: BinaryIO, path: Path) -> _Header:
    lines = _header_lines(file, path)
    require(
        lines[1:2] == ["format binary_little_endian 1.0"],
        f"{path}: expected 'format binary_little_endian 1.0', got '{(lines[1:2] or [''])[0][:60]}';"
        " convert the file",
    )
    count: int | None = None
    names: list[str] = []
    background: list[float] | None = None
    banded = 0
    for line in lines[2:]:
        match line.split():
            case ["comment", "background", *values]:
                background = _background(values, path)
            case ["comment", "bands", number] if COUNT.fullmatch(number):
                banded = int(number)
            case ["comment" | "obj_info", *_]:
                pass
            case ["element", "vertex", number] if count is None and COUNT.fullmatch(number):
                count = int(number)
            case ["property", kind, name] if count is not None and kind in FLOAT_NAMES:
                names.append(name)
            case _:
                raise UserError(
                    f"{path}: expected one element 'vertex' with float properties, got"
                    f" '{line[:60]}'; this is not a Gaussian splat file"
                )
    require(
        count is not None and len(names) == len(set(names)) > 0,
        f"{path}: expected one 'element vertex' with distinct properties, got {len(names)}"
        " properties; this is not a Gaussian splat file",
    )
    return _Header(count or 0, tuple(names), background, banded)


def _header_lines(file: BinaryIO, path: Path) -> list[str]:
    """The lines before `end_header`; `file` is left at the first data byte."""
    lines: list[str] = []
    while file.tell() < HEADER_LIMIT:
        raw = file.readline(HEADER_LIMIT)
        line = raw.decode("ascii", errors="replace").strip()
        if not raw.endswith(b"\n") or (not lines and line != "ply"):
            break
        if line == "end_header":
            return lines
        lines.append(line)
    raise UserError(
        f"{path}: expected a PLY header from 'ply' to 'end_header', got none; not a PLY"
    )


def _background(values: list[str], path: Path) -> list[float]:
    try:
        red, green, blue = (float(value) for value in values)
        if not all(map(math.isfinite, (red, green, blue))):
            raise ValueError("NaN or infinity")
    except ValueError as error:
        raise UserError(
            f"{path}: expected 'comment background r g b' with three finite numbers, got"
            f" '{' '.join(values)[:60]}'; correct the header"
        ) from error
    return [red, green, blue]
