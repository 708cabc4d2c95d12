"""Gaussians in the PLY layout of 3DGS (Kerbl et al. 2023), which splat viewers open.

Written as binary little endian, one element `vertex`, all properties float32: `x y z nx ny nz
f_dc_0..2 f_rest_* opacity scale_0..2 rot_0..3`. Stored are the unactivated parameters: logits,
log-scales, wxyz quaternions. `f_rest` is channel-major: all coefficients of red, then of green,
then of blue.
The header comment `background r g b` holds the colour the Gaussians were trained against.

If only the first M of the N Gaussians have SH bands above 0, the PLY has none and the comment
`bands M`; `shN` [M, K-1, 3] is in `NAME_sh.npy` next to `NAME.ply`. In a PLY all vertices have the
same properties, and viewers do not read a second element.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.errors import require
from framework.files.opened import is_file, reading
from framework.files.ply import COUNT, read_commented
from framework.files.whole import write_whole

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

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

    def gaussians(self) -> Gaussians:
        """The same as tensors."""
        import torch

        from framework.types import Gaussians

        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "background"}
        return Gaussians(**{name: torch.from_numpy(array) for name, array in arrays.items()})


def read_ply(path: Path) -> tuple[Gaussians, Tensor | None]:
    """The Gaussians (float32) and the background [3], None if the file lacks it.

    Raises as `read_splats`.
    """
    import torch

    splats = read_splats(path)
    background = None if splats.background is None else torch.tensor(splats.background)
    return splats.gaussians(), background


def read_splats(path: Path) -> Splats:
    """The content as arrays, without torch.

    Raises:
        UserError: if the file is not such a PLY, is damaged, or holds a value that is not finite.
    """
    vertices, comments = read_commented(path)
    names = vertices.dtype.names or ()
    rest = _rest_count(names, path)
    used = [name for name in property_names(rest) if name not in NORMALS]
    finite = np.logical_and.reduce([np.isfinite(vertices[name]) for name in used])
    bad = np.flatnonzero(~finite)
    require(
        not len(bad),
        f"{path}: expected finite parameters, got NaN or infinity in {len(bad)} vertices (first:"
        f" {bad[0] if len(bad) else ''}); remove them or export the model again",
    )
    words = {comment[0]: comment[1:] for comment in comments if comment}
    background = _background(words["background"], path) if "background" in words else None
    splats = replace(_from_table(vertices, rest), background=background)
    banded = words.get("bands", ["0"])[0]
    if not COUNT.fullmatch(banded) or int(banded) == 0:
        return splats
    return replace(splats, shN=_read_bands(path, names, int(banded), len(vertices)))


def _read_bands(path: Path, names: Sequence[str], m: int, count: int) -> np.ndarray:
    """Read [M, K-1, 3] from the file that the header of `path` names."""
    from framework.files.arrays import read_npy

    bands_file = bands_path(path)
    require(
        not any(name.startswith("f_rest_") for name in names) and 0 < m < count,
        f"{path}: expected 'comment bands M' with 0 < M < {count} and no f_rest properties,"
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


def _from_table(vertices: np.ndarray, rest: int) -> Splats:
    def take(*names: str) -> np.ndarray:
        columns = [vertices[name] for name in names]
        return np.stack(columns, axis=1).astype(np.float32) if columns else np.zeros((n, 0), "f4")

    n = len(vertices)
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


def _rest_count(names: Sequence[str], path: Path) -> int:
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


def _background(values: list[str], path: Path) -> list[float]:
    with reading(path, "'comment background r g b' with three finite numbers"):
        red, green, blue = (float(value) for value in values)
        if not all(map(math.isfinite, (red, green, blue))):
            raise ValueError("NaN or infinity")
    return [red, green, blue]
