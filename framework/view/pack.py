"""Packs the Gaussians of a run for the page, which unpacks them in `assets/model.js`.

Little-endian arrays, one after the other, then gzip:

    means [N, 3]      float32
    log_scales [N, 3] 16 bits between the extremes
    quats [N, 4]      of unit length, 16 bits with a sign
    opacities [N]     16 bits from 0 to 1
    sh0 [N, 3]        16 bits between the extremes
    shN [M, K-1, 3]   8 bits: 128 + 127 sign(v) sqrt(|v| / range), with the largest |v| of the
                      degree as range; this is finer near 0, where most values are

A picture of the packed Gaussians differs from one of the originals by far less than its 8 bits.
"""

import base64
import gzip
from dataclasses import dataclass
from typing import Any

import numpy as np

from framework.records.ply import Splats

LEVELS = 65535
SIZES = (-40.0, 40.0)  # of log_scales whose exponentials float32 can hold
COLOURS = (-1e3, 1e3)
DEGREES = ((0, 3), (3, 8), (8, 15))  # the coefficients of SH degree 1, 2 and 3


@dataclass(frozen=True)
class Packed:
    """Packed Gaussians.

    Attributes:
        n, banded, rest: N, M and K - 1.
        log_scales, sh0: (lowest, highest).
        bands: range of each degree.
        text: gzip in base64.
    """

    n: int
    banded: int
    rest: int
    log_scales: tuple[float, float]
    sh0: tuple[float, float]
    bands: tuple[float, ...]
    text: str


def packed(splats: Splats) -> Packed:
    """Pack the Gaussians."""
    rest = splats.shN.shape[1]
    banded = len(splats.shN) if rest else 0
    scales, scale_range = _levels(splats.log_scales, *SIZES)
    colours, colour_range = _levels(splats.sh0, *COLOURS)
    bands, ranges = _bands(splats.shN)
    opacities = 1 / (1 + np.exp(-splats.opacity_logits.astype(np.float64).clip(-50, 50)))
    arrays = (
        splats.means.astype("<f4"),
        scales,
        np.rint(32767 * _unit(splats.quats)).astype("<i2"),
        np.rint(LEVELS * opacities).astype("<u2"),
        colours,
        bands,
    )
    content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    text = base64.b64encode(gzip.compress(content, 6, mtime=0)).decode("ascii")
    return Packed(len(splats.means), banded, rest, scale_range, colour_range, ranges, text)


def _levels(values: Any, lowest: float, highest: float) -> tuple[np.ndarray, tuple[float, float]]:
    """Values as 16 bits between their extremes, and the extremes."""
    clipped = np.clip(values.astype(np.float64), lowest, highest)
    low, high = (float(clipped.min()), float(clipped.max())) if clipped.size else (0.0, 0.0)
    width = max(high - low, 1e-12)
    return np.rint(LEVELS * (clipped - low) / width).astype("<u2"), (low, low + width)


def _unit(quats: np.ndarray) -> np.ndarray:
    """[N, 4] float64 of length 1, or 0 if the length is 0."""
    wide = quats.astype(np.float64)
    lengths = np.linalg.norm(wide, axis=1, keepdims=True)
    return np.asarray(wide / np.where(lengths > 0, lengths, 1.0))


def _bands(shN: np.ndarray) -> tuple[np.ndarray, tuple[float, ...]]:
    """[M, K-1, 3] uint8 and the range of each degree."""
    coded, ranges = np.zeros(shN.shape, np.uint8), [0.0, 0.0, 0.0]
    for degree, (first, end) in enumerate(DEGREES):
        part = np.clip(shN[:, first:end].astype(np.float64), *COLOURS)
        if part.size:
            ranges[degree] = max(float(np.abs(part).max()), 1e-12)
            share = np.sqrt(np.abs(part) / ranges[degree])
            coded[:, first:end] = np.rint(128 + 127 * np.sign(part) * share)
    return coded, tuple(ranges)
