"""The photographs bundled with scikit-image that clothe the embedded scene.

Only files inside its wheel, and only PNG: their decoding is exact, that of JPEG is not.
"""

import numpy as np
from numpy.typing import NDArray

NAMES = (
    *("astronaut", "brick", "chelsea", "coffee", "coins"),
    *("grass", "gravel", "moon", "page", "immunohistochemistry"),
)
TURNED = ("brick",)  # its courses run upright in the photograph


def load(name: str) -> NDArray[np.uint8]:
    """[H, W, 3] uint8, the photograph `name` of `skimage.data`."""
    import skimage.data

    pixels = np.asarray(getattr(skimage.data, name)())
    if name in TURNED:
        pixels = np.swapaxes(pixels, 0, 1)
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    return np.ascontiguousarray(pixels[:, :, :3], dtype=np.uint8)


def pack() -> tuple[NDArray[np.uint8], NDArray[np.int64], NDArray[np.float64]]:
    """All textures: texels, (offset, height, width) and linear (gamma 2) mean colour of each."""
    pictures = [load(name) for name in NAMES]
    sizes = np.array([p.size for p in pictures], dtype=np.int64)
    offsets = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(sizes)[:-1]])
    shapes = [(o, p.shape[0], p.shape[1]) for o, p in zip(offsets, pictures, strict=True)]
    # integer sums: exact in any order
    sums = [(p.astype(np.int64) ** 2).sum(axis=(0, 1)) for p in pictures]
    means = [s / (p.shape[0] * p.shape[1] * 65025.0) for s, p in zip(sums, pictures, strict=True)]
    texels = np.concatenate([p.reshape(-1) for p in pictures])
    return texels, np.array(shapes, dtype=np.int64), np.array(means)
