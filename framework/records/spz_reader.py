"""Reads Niantic SPZ files of version 3, which `fishersplat export` writes.

A gzip stream of a header and arrays. The header has the magic word, the version, the number of
Gaussians, the SH degree, the bits behind the point of a coordinate, and flags. The arrays are

    means [N, 3]      24 bits
    opacities [N]     8 bits from 0 to 1
    sh0 [N, 3]        8 bits
    log_scales [N, 3] 8 bits, in sixteenths from -10
    quats [N]         32 bits, the smallest three components
    shN [N, K-1, 3]   8 bits

The axes are right, up and back; the result has those of a splat PLY: right, down and forward.

Source: nianticlabs/spz, load-spz.cc.
"""

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from framework.errors import require
from framework.files.limits import PLY_BYTES
from framework.files.opened import read_bytes, reading
from framework.records.ply import Splats

SUFFIX = ".spz"
HEADER = struct.Struct("<4sIIBBBB")
GZIP = 16 + zlib.MAX_WBITS  # of zlib's decoder: expect a gzip header
BYTES = 20  # of a Gaussian without SH bands
COLOUR_SCALE = 0.15
PARTS_OF_ONE = 511  # of a component of a quaternion, which is at most sqrt(1/2)
# of shN when y and z change their signs
SIGNS = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)


def read_spz(path: Path) -> Splats:
    """The Gaussians of a file, without a background.

    Raises:
        UserError: unless it is a whole SPZ file of version 3.
    """
    return unpacked(read_bytes(path, PLY_BYTES), path)


def unpacked(content: bytes, where: object) -> Splats:
    """The Gaussians of a file's content. Raises as `read_spz`.

    Args:
        where: named in errors.
    """
    decoder = zlib.decompressobj(GZIP)
    with reading(where, "an SPZ file", "export it again"):
        header = decoder.decompress(content, HEADER.size)
        require(len(header) == HEADER.size and header[:4] == b"NGSP", f"{where}: not an SPZ file")
        _, version, n, degree, fraction, _, _ = HEADER.unpack(header)
        require(
            version == 3 and n > 0 and degree <= 3 and fraction <= 24,
            f"{where}: expected SPZ of version 3 with Gaussians of SH degree 0 to 3, got version"
            f" {version}, {n} Gaussians, degree {degree}; export the run again",
        )
        rest = (degree + 1) ** 2 - 1
        size = n * (BYTES + 3 * rest)
        require(size <= PLY_BYTES, f"{where}: expected at most {PLY_BYTES:,} bytes, got {size:,}")
        body = decoder.decompress(decoder.unconsumed_tail, size)
    require(len(body) == size, f"{where}: the file is cut off; export the run again")
    values = np.frombuffer(body, np.uint8)
    ends = np.cumsum([9 * n, n, 3 * n, 3 * n, 4 * n])
    means, opacities, sh0, log_scales, quats, shN = np.split(values, ends)
    shares = (opacities.astype(np.float32) / 255).clip(1e-6, 1 - 1e-6)
    bands = (shN.reshape(n, rest, 3).astype(np.float32) - 128) / 128
    return Splats(
        means=_means(means.reshape(n, 3, 3), fraction),
        quats=_quats(quats.view("<u4")),
        log_scales=log_scales.reshape(n, 3).astype(np.float32) / 16 - 10,
        opacity_logits=np.log(shares / (1 - shares)),
        sh0=(sh0.reshape(n, 1, 3).astype(np.float32) / 255 - 0.5) / np.float32(COLOUR_SCALE),
        shN=bands * SIGNS[:rest, None],
        background=None,
    )


def _means(digits: NDArray[np.uint8], fraction: int) -> NDArray[np.float32]:
    """[N, 3] of little-endian signed integers of three bytes each."""
    wide = np.zeros((*digits.shape[:2], 4), np.uint8)
    wide[..., 1:] = digits
    whole = wide.view("<i4")[..., 0] >> 8  # keeps the sign
    return (whole * np.array([1, -1, -1]) / 2**fraction).astype(np.float32)


def _quats(words: NDArray[np.uint32]) -> NDArray[np.float32]:
    """[N, 4] wxyz; the largest component of xyzw is positive and not stored."""
    largest = (words >> 30).astype(np.int64)
    quats = np.zeros((len(words), 4))
    for axis in (3, 2, 1, 0):
        stored = axis != largest
        size = (words & PARTS_OF_ONE) / (PARTS_OF_ONE * np.sqrt(2))
        quats[:, axis] = np.where(stored, np.where(words >> 9 & 1, -size, size), 0)
        words = np.where(stored, words >> 10, words)
    rows = np.arange(len(words))
    quats[rows, largest] = np.sqrt(np.maximum(0, 1 - (quats**2).sum(1)))
    x, y, z, w = quats.T
    return np.stack([w, x, -y, -z], axis=1).astype(np.float32)
