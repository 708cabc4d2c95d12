"""Converts Gaussians to file formats. All but SPZ keep the axes of a splat PLY (y down).

- `ply`: as 3DGS writes it; every Gaussian has the SH bands of the highest.
- `compressed-ply` (PlayCanvas): chunks of 256, 16 bytes each and a byte per SH coefficient. By
  gsply (MIT).
- `spz` (Niantic), version 3: gzip, quaternions by their smallest three components. Version 4 packs
  the same numbers with zstd, which fewer programs read; version 2 has coarser rotations. Its axes
  are right, up, back, so the model is turned by 180 degrees about x. By gsply.
- `splat` (antimatter15): 32 bytes each, sorted by how much they cover; colours without SH bands.
- `sog` (PlayCanvas): WebP images in a ZIP, SH bands by a palette. By gaussforge (Apache-2.0), the
  extra `sog`.
"""

from __future__ import annotations

import importlib.util
import logging
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from framework.errors import UserError, require

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Gaussians

LOG = logging.getLogger(__name__)
Y0 = 0.28209479177387814  # the harmonic of degree 0: 1 / (2 sqrt(pi))
SPZ_VERSION = 3
SPZ_BITS = 24  # of a coordinate, signed; how many are behind the point is for the file to say
SPZ_FRACTION = (4, 14)  # least and most of these; readers shift by them
SPZ_LOG_SCALES = (-10.0, 5.94)  # of a byte that counts sixteenths
SPZ_LOST = 0.01  # share of the Gaussians that may be changed in size or place
TURNED = np.diag([1.0, -1.0, -1.0, 1.0])  # right, down, forward to right, up, back

SUFFIXES = {
    "ply": ".ply",
    "compressed-ply": ".compressed.ply",
    "spz": ".spz",
    "splat": ".splat",
    "sog": ".sog",
}


def packed(gaussians: Gaussians, background: Tensor, kind: str) -> bytes:
    """Return the content of a file of this kind.

    Raises:
        UserError: if its package is missing.
    """
    check_writer(kind)
    return _WRITERS[kind](full(gaussians), background)


def can_write(kind: str) -> bool:
    """Return whether the package that writes this kind is installed."""
    return kind != "sog" or importlib.util.find_spec("gaussforge") is not None


def check_writer(kind: str) -> None:
    """Raise UserError if the package that writes this kind is missing."""
    require(
        can_write(kind),
        f"{kind}: needs the package gaussforge, which is not installed; pip install"
        f" 'fishersplat[{kind}]', or choose another format",
    )


def full(gaussians: Gaussians) -> Gaussians:
    """Give all Gaussians SH bands, with zeros where there were none."""
    import torch

    n, bands = len(gaussians), gaussians.shN
    if gaussians.sh_degree == 0:
        return gaussians.replace(shN=bands.new_zeros(n, 0, 3))
    return gaussians.replace(
        shN=torch.cat([bands, bands.new_zeros(n - len(bands), *bands.shape[1:])])
    )


def _ply(gaussians: Gaussians, background: Tensor) -> bytes:
    from framework.records.ply import write_ply

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "a.ply"
        write_ply(file, gaussians, background)
        return file.read_bytes()


def _compressed_ply(gaussians: Gaussians, background: Tensor) -> bytes:
    import gsply

    def write(file: str) -> None:
        gsply.plywrite(file, _for_gsply(gaussians), compressed=True)
        _check_places(gaussians, np.asarray(gsply.plyread(file).means))

    return _written(".compressed.ply", write)


def _check_places(gaussians: Gaussians, stored: NDArray[np.floating[Any]]) -> None:
    """Warn where a far Gaussian makes the grid of its chunk coarser than its neighbours.

    Args:
        stored: [N, 3], the means as a reader gets them.
    """
    error = np.abs(stored - gaussians.means.numpy()).max(axis=1)
    lost = error > gaussians.scales.max(1).values.numpy()
    if lost.any():
        LOG.warning(
            f"compressed-ply: {lost.sum():,} of {len(lost):,} Gaussians move by up to"
            f" {error.max():.2g} scene units, more than their size, as some are far away; use"
            " another format where that matters"
        )


def _spz(gaussians: Gaussians, background: Tensor) -> bytes:
    return spz(gaussians, finest_fraction(gaussians))


def finest_fraction(gaussians: Gaussians) -> int:
    """The most bits behind the point with which an SPZ file holds the coordinates.

    Raises:
        UserError: if even the least are too many.
    """
    farthest = float(gaussians.means.abs().max())
    least, most = SPZ_FRACTION
    fraction = min(most, SPZ_BITS - 1 - math.ceil(math.log2(max(farthest, 1.0) * 1.0001)))
    require(
        fraction >= least,
        f"spz: expected Gaussians within {2 ** (SPZ_BITS - 1 - least):,} of the middle, got one at"
        f" {farthest:.4g}; use another format",
    )
    return fraction


def spz(gaussians: Gaussians, fraction: int) -> bytes:
    """Return the content of an SPZ file.

    Args:
        gaussians: all of them with SH bands.
        fraction: bits behind the point of a coordinate.

    Raises:
        UserError: if their scales do not fit.
    """
    import gsply

    from framework.exports.upright import moved_gaussians

    turned = moved_gaussians(gaussians, TURNED)
    largest = turned.log_scales.max(1).values
    finest = finest_fraction(gaussians)
    low = max(-finest * math.log(2), SPZ_LOG_SCALES[0])  # means are rounded to a grid, too
    high = SPZ_LOG_SCALES[1]
    lost = float(((largest < low) | (largest > high)).float().mean())
    require(
        lost <= SPZ_LOST,
        f"spz: expected Gaussians of {math.exp(low):.2g} to {math.exp(high):.3g} scene units, which"
        f" it can hold, got {lost:.0%} of other sizes; use another format",
    )
    data = _for_gsply(turned)
    return _written(
        ".spz",
        lambda file: gsply.write_spz(file, data, version=SPZ_VERSION, fractional_bits=fraction),
    )


def _splat(gaussians: Gaussians, background: Tensor) -> bytes:
    if gaussians.shN.numel() and bool(gaussians.shN.any()):
        LOG.warning(
            "splat: holds no SH bands, so colours no longer change with the direction; use another"
            " format to keep them"
        )
    scales, opacities = gaussians.scales.numpy(), gaussians.opacities.numpy()
    order = np.argsort(-scales.prod(axis=1) * opacities, kind="stable")
    quats = gaussians.quats.numpy()
    quats = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    colours = 0.5 + Y0 * gaussians.sh0[:, 0].numpy()
    rows = np.zeros(
        len(gaussians),
        [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)],
    )
    rows["mean"], rows["scale"] = gaussians.means.numpy(), scales
    rows["rgba"][:, :3], rows["rgba"][:, 3] = _byte(255 * colours), _byte(255 * opacities)
    rows["quat"] = _byte(128 + 128 * quats)
    return rows[order].tobytes()


def _byte(values: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    return np.rint(values.clip(0, 255)).astype(np.uint8)


def _sog(gaussians: Gaussians, background: Tensor) -> bytes:
    import gaussforge

    result = gaussforge.GaussForge().convert(_ply(gaussians, background), "ply", "sog")
    if "error" in result:
        raise UserError(f"sog: expected gaussforge to write it, got '{result['error']}'")
    return bytes(result["data"])


def _for_gsply(gaussians: Gaussians) -> Any:
    """The same values as gsply holds them."""
    import gsply

    from framework.types import degree_of

    n, rest = len(gaussians), gaussians.shN.shape[1]
    bands: Any = gaussians.shN.numpy() if rest else None
    return gsply.GSData(
        means=gaussians.means.numpy(),
        scales=gaussians.log_scales.numpy(),
        quats=(gaussians.quats / gaussians.quats.norm(dim=1, keepdim=True)).numpy(),
        opacities=gaussians.opacity_logits.numpy(),
        sh0=gaussians.sh0.reshape(n, 3).numpy(),
        shN=bands,
        _format=gsply.create_ply_format(degree_of(rest)),
    )


def _written(suffix: str, write: Callable[[str], object]) -> bytes:
    """What `write` puts into a file."""
    logging.getLogger("gsply").setLevel(logging.WARNING)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"a{suffix}"
        write(str(file))
        return file.read_bytes()


_WRITERS: dict[str, Callable[[Gaussians, Tensor], bytes]] = {
    "ply": _ply,
    "compressed-ply": _compressed_ply,
    "spz": _spz,
    "splat": _splat,
    "sog": _sog,
}
