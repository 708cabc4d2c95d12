"""Triangulated points of the embedded scene, as structure from motion would find them.

Detail-rich pixels of the training views are lifted with their exact depth and kept where at least
two training views see them by the depth test. So their positions are exact (real points are not);
only elementwise `+ - * /` and comparisons are used, for identical bits.
"""

import numpy as np
from numpy.typing import NDArray

CELL = 8  # pixels; at most one point per cell and view
DETAIL = 24  # least horizontal + vertical grey difference, of 3 x 255
FLAT = 0.01  # relative depth range within which a 3 x 3 neighbourhood is one surface
AGREE = 0.01  # relative depth difference up to which a view sees the point


def _detail(image: NDArray[np.uint8], depth: NDArray[np.float32]) -> NDArray[np.int64]:
    """[H, W] integer gradient magnitude; 0 on the border and beside a step in depth."""
    grey = image.astype(np.int64).sum(axis=2)
    strength = np.zeros_like(grey)
    dx = np.abs(grey[1:-1, 2:] - grey[1:-1, :-2])
    dy = np.abs(grey[2:, 1:-1] - grey[:-2, 1:-1])
    height, width = depth.shape
    shifted = [depth[i : height - 2 + i, j : width - 2 + j] for i in range(3) for j in range(3)]
    low, high = np.minimum.reduce(shifted), np.maximum.reduce(shifted)
    strength[1:-1, 1:-1] = np.where(high - low < FLAT * low, np.minimum(dx, dy) + (dx + dy) // 8, 0)
    return strength


def _corners(strength: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the strongest pixel of each cell (the first of equals)."""
    height, width = (size // CELL * CELL for size in strength.shape)
    blocks = strength[:height, :width].reshape(height // CELL, CELL, width // CELL, CELL)
    cells = blocks.transpose(0, 2, 1, 3).reshape(height // CELL, width // CELL, CELL * CELL)
    best = cells.argmax(axis=2)
    i, j = np.nonzero(cells.max(axis=2) >= DETAIL)
    return i * CELL + best[i, j] // CELL, j * CELL + best[i, j] % CELL


def _lift(pose: NDArray, focal: float, depth: NDArray, row: NDArray, column: NDArray) -> NDArray:
    """[M, 3] world points at the centres of the pixels."""
    height, width = depth.shape
    z = depth[row, column].astype(np.float64)
    x = (column + 0.5 - 0.5 * width) / focal * z
    y = (row + 0.5 - 0.5 * height) / focal * z
    return np.stack(
        [pose[k, 0] * x + pose[k, 1] * y + pose[k, 2] * z + pose[k, 3] for k in range(3)], axis=1
    )


def _sees(pose: NDArray, focal: float, depth: NDArray, xyz: NDArray) -> NDArray[np.bool_]:
    """[M] whether a view sees each point: inside the image and at the depth of its pixel."""
    away = xyz - pose[:, 3]
    x, y, z = (
        away[:, 0] * pose[0, k] + away[:, 1] * pose[1, k] + away[:, 2] * pose[2, k]
        for k in range(3)
    )
    height, width = depth.shape
    ahead = z > 0
    safe = np.where(ahead, z, 1.0)
    column = np.floor(focal * x / safe + 0.5 * width).astype(np.int64)
    row = np.floor(focal * y / safe + 0.5 * height).astype(np.int64)
    inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
    there = depth[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)].astype(np.float64)
    return inside & (np.abs(there - z) < AGREE * z)


def sparse_points(
    images: NDArray[np.uint8],
    depths: NDArray[np.float32],
    poses: NDArray[np.float64],
    focal: float,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.bool_]]:
    """xyz [M, 3], rgb [M, 3], visible [M, V] of the points at least two of the V views see.

    Args:
        images: [V, H, W, 3].
        depths: [V, H, W].
        poses: [V, 3, 4] camera-to-world.
        focal: pixels.
    """
    xyz, rgb = [], []
    for image, depth, pose in zip(images, depths, poses, strict=True):
        row, column = _corners(_detail(image, depth))
        xyz.append(_lift(pose, focal, depth, row, column))
        rgb.append(image[row, column])
    points, colours = np.concatenate(xyz), np.concatenate(rgb)
    visible = np.stack(
        [_sees(pose, focal, d, points) for pose, d in zip(poses, depths, strict=True)], axis=1
    )
    keep = visible.sum(axis=1) >= 2
    return points[keep], colours[keep], visible[keep]
