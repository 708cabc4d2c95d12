"""Gaussians in the PLY layout of 3DGS (Kerbl et al. 2023), which splat viewers open.

Binary little endian, one element `vertex`, all properties float32: `x y z nx ny nz f_dc_0..2
f_rest_* opacity scale_0..2 rot_0..3`. Stored are the unactivated parameters: logits, log-scales,
wxyz quaternions. `f_rest` is channel-major: all coefficients of red, then of green, then of blue.
Where only the first M of the N Gaussians have SH bands above 0, `vertex` has no `f_rest`; a second
element `sh` of M rows has them, which a reader that does not know it may leave out.
The header comment `background r g b` holds the colour the Gaussians were trained against.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from framework.errors import UserError, require
from framework.files import write_whole
from framework.limits import PLY_BYTES, check_size

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

HEADER_LIMIT = 65536  # bytes; no splat header is near it, a file that is no PLY soon is
COUNT = re.compile(r"\d{1,15}", re.ASCII)
FLOAT_NAMES = ("float", "float32")
NORMALS = {"nx", "ny", "nz"}  # written for viewers that expect them, but without a meaning
BANDS = "sh"
ELEMENTS = ("vertex", BANDS, "")  # in this order, the second one may be missing
REST_COUNTS = {0: 0, 9: 3, 24: 8, 45: 15}  # number of f_rest properties -> coefficients per channel


def rest_names(rest: int) -> list[str]:
    """The property names of `rest` higher SH coefficients per channel."""
    return [f"f_rest_{i}" for i in range(3 * rest)]


def property_names(rest: int) -> list[str]:
    """The property names in order, with `rest` higher SH coefficients per channel."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *rest_names(rest),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def write_ply(path: Path, gaussians: Gaussians, background: Tensor) -> int:
    """Write `gaussians` (as float32) and `background` [3]; returns the file's size in bytes."""
    n, banded, rest = len(gaussians), len(gaussians.shN), gaussians.shN.shape[1]
    within = rest if banded == n else 0
    table = _to_table(gaussians, within)
    red, green, blue = (repr(float(c)) for c in background.detach().cpu())
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment background {red} {green} {blue}",
        f"element vertex {n}",
        *(f"property float {name}" for name in property_names(within)),
    ]
    content = table.tobytes()
    if 0 < banded < n:
        header += [f"element {BANDS} {banded}"]
        header += [f"property float {name}" for name in rest_names(rest)]
        content += _rest_columns(gaussians).tobytes()
    content = "\n".join([*header, "end_header"]).encode("ascii") + b"\n" + content
    write_whole(path, content)
    return len(content)


def read_ply(path: Path) -> tuple[Gaussians, Tensor | None]:
    """The Gaussians (float32) and the background [3], None where the file does not tell it.

    Raises UserError when the file is missing, is no splat PLY, is too large, its size contradicts
    its header, or it holds NaN or infinity.
    """
    import torch

    require(path.is_file(), f"{path}: expected a PLY file, found none; check the path")
    check_size(path, PLY_BYTES)
    with path.open("rb") as file:
        header = _read_header(file, path)
        rest = _rest_count(header, path)
        counts = [(header.count, len(header.names)), (header.banded, len(header.band_names))]
        expected = file.tell() + 4 * sum(rows * columns for rows, columns in counts)
        found = os.fstat(file.fileno()).st_size
        require(
            found == expected,
            f"{path}: expected {expected} bytes for {header.count} vertices, got {found};"
            " the file is damaged, write it again",
        )
        raw, bands = (
            np.fromfile(file, dtype="<f4", count=rows * columns).reshape(rows, columns)
            for rows, columns in counts
        )
    background = header.background
    columns = {name: index for index, name in enumerate(header.names)}
    if header.band_names:
        bands = bands[:, [header.band_names.index(name) for name in rest_names(rest)]]
        used = [name for name in property_names(0) if name not in NORMALS]
    else:
        bands = raw[:, [columns[name] for name in rest_names(rest)]]
        used = [name for name in property_names(rest) if name not in NORMALS]
    for table in (raw[:, [columns[name] for name in used]], bands):
        bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
        require(
            not len(bad),
            f"{path}: expected finite parameters, got NaN or infinity in {len(bad)} vertices"
            f" (first: {bad[0] if len(bad) else ''}); remove them or export the model again",
        )
    gaussians = _from_tables(raw, columns, bands, rest)
    return gaussians, None if background is None else torch.tensor(background)


def _rest_columns(gaussians: Gaussians) -> np.ndarray:
    """[M, 3 (K-1)] little-endian float32, columns as `rest_names`."""
    rows = gaussians.shN.detach().cpu().numpy().astype("<f4").transpose(0, 2, 1)
    return np.ascontiguousarray(rows.reshape(len(rows), rows.shape[1] * rows.shape[2]))


def _to_table(gaussians: Gaussians, rest: int) -> np.ndarray:
    """[N, P] little-endian float32, columns as `property_names(rest)`."""
    g = {name: t.detach().cpu().numpy().astype("<f4") for name, t in gaussians.items()}
    n = len(gaussians)
    parts = [g["means"], np.zeros((n, 3), "<f4"), g["sh0"].reshape(n, 3)]
    parts += [_rest_columns(gaussians)] if rest else []
    parts += [g["opacity_logits"].reshape(n, 1), g["log_scales"], g["quats"]]
    return np.ascontiguousarray(np.concatenate(parts, axis=1))


def _from_tables(
    raw: np.ndarray, columns: dict[str, int], bands: np.ndarray, rest: int
) -> Gaussians:
    """From the vertices and the `rest_names` of the first of them."""
    import torch

    from framework.types import Gaussians

    def take(*names: str) -> Tensor:
        return torch.from_numpy(
            raw[:, [columns[name] for name in names]].astype(np.float32, order="C")
        )

    n = len(raw)
    higher = torch.from_numpy(bands.astype(np.float32, order="C"))
    return Gaussians(
        means=take("x", "y", "z"),
        quats=take(*(f"rot_{i}" for i in range(4))),
        log_scales=take(*(f"scale_{i}" for i in range(3))),
        opacity_logits=take("opacity").reshape(n),
        sh0=take(*(f"f_dc_{i}" for i in range(3))).reshape(n, 1, 3),
        shN=higher.reshape(len(bands), 3, rest).transpose(1, 2).contiguous(),
    )


def _rest_count(header: _Header, path: Path) -> int:
    """Higher SH coefficients per channel of a file with these properties."""
    names = header.band_names or header.names
    n_rest = sum(name.startswith("f_rest_") for name in names)
    require(
        n_rest in REST_COUNTS,
        f"{path}: expected 0, 9, 24 or 45 f_rest properties (SH degree 0 to 3), got {n_rest};"
        " export it again with a degree up to 3",
    )
    rest = REST_COUNTS[n_rest]
    needed = property_names(0 if header.band_names else rest)
    absent = (set(needed) - NORMALS - set(header.names)) | (set(rest_names(rest)) - set(names))
    require(
        not absent,
        f"{path}: expected the 3DGS properties, got none named {', '.join(sorted(absent)[:4])};"
        " this is not a Gaussian splat file",
    )
    return rest


@dataclass(frozen=True)
class _Header:
    count: int
    names: tuple[str, ...]
    banded: int
    band_names: tuple[str, ...]
    background: list[float] | None


def _read_header(file: BinaryIO, path: Path) -> _Header:
    lines = _header_lines(file, path)
    require(
        lines[1:2] == ["format binary_little_endian 1.0"],
        f"{path}: expected 'format binary_little_endian 1.0', got '{(lines[1:2] or [''])[0][:60]}';"
        " convert the file",
    )
    counts: dict[str, int] = {}
    names: dict[str, list[str]] = {}
    background: list[float] | None = None
    for line in lines[2:]:
        match line.split():
            case ["comment", "background", *values]:
                background = _background(values, path)
            case ["comment" | "obj_info", *_]:
                pass
            case ["element", element, number] if element == ELEMENTS[
                len(counts)
            ] and COUNT.fullmatch(number):
                counts[element], names[element] = int(number), []
            case ["property", kind, name] if counts and kind in FLOAT_NAMES:
                names[[*counts][-1]].append(name)
            case _:
                raise UserError(
                    f"{path}: expected one element 'vertex' with float properties, got"
                    f" '{line[:60]}'; this is not a Gaussian splat file"
                )
    for element in ("vertex", *counts):
        found = names.get(element, [])
        require(
            len(found) == len(set(found)) > 0,
            f"{path}: expected one 'element {element}' with distinct properties, got {len(found)}"
            " properties; this is not a Gaussian splat file",
        )
    n, banded = counts["vertex"], counts.get(BANDS, 0)
    require(
        BANDS not in counts or 0 < banded < n,
        f"{path}: expected 1 to {n - 1} rows of '{BANDS}' for {n} vertices, got {banded}; the file"
        " is damaged, write it again",
    )
    return _Header(n, tuple(names["vertex"]), banded, tuple(names.get(BANDS, ())), background)


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
