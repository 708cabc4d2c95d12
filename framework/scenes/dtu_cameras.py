"""The cameras of a DTU scan from the projections in `cameras_sphere.npz`.

P = K [R | t] is split by the RQ decomposition of its left 3 x 3 block (Hartley & Zisserman, 2004,
section 6.2.4), with a positive diagonal of K and K[2, 2] = 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import inverse, product
from framework.errors import UserError, require
from framework.files.arrays import read_npz
from framework.files.opened import is_file
from framework.scenes.cameras import checked_lens, checked_pose
from framework.scenes.lens import Lens

FILES = ("cameras_sphere.npz", "cameras.npz")
WIDTH, HEIGHT = 1600, 1200  # of the photos the projections are for
LARGEST = 1e15  # of a projection: a focal length times a position, each within its limits
MOST_SKEW = 1e-3  # of the focal length


@dataclass(frozen=True)
class Calibration:
    """viewmat: [4, 4] world-to-camera in millimetres. lens: for photos of 1600 x 1200."""

    viewmat: NDArray[np.float64]
    lens: Lens


def read_cameras(folder: Path, positions: Sequence[int]) -> dict[int, Calibration]:
    """Read the calibrations of the positions.

    Raises:
        UserError: for missing or invalid ones.
    """
    path = next((folder / name for name in FILES if is_file(folder / name)), None)
    if path is None:
        raise UserError(
            f"{folder}: expected the cameras in {' or '.join(FILES)}, found neither; is scene.path"
            " the folder of one scan?"
        )
    matrices = read_npz(path, [f"world_mat_{i}" for i in positions])
    return {
        i: decompose(matrix, f"{path}: world_mat_{i}")
        for i, matrix in zip(positions, matrices, strict=True)
    }


def decompose(matrix: NDArray, where: str) -> Calibration:
    """The calibration of a projection, [3, 4] or [4, 4]; `where` starts a message."""
    good = matrix.shape in ((3, 4), (4, 4)) and matrix.dtype.kind in "fiu"
    require(
        good and bool((np.abs(matrix.astype(np.float64)) <= LARGEST).all()),
        f"{where}: expected a 3x4 or 4x4 projection of numbers up to {LARGEST:g}, got"
        f" {'NaN or infinity or more' if good else f'{matrix.shape} {matrix.dtype}'}; replace the"
        " file",
    )
    projection = matrix[:3].astype(np.float64)
    determinant = (np.cross(projection[0, :3], projection[1, :3]) * projection[2, :3]).sum()
    require(
        abs(determinant) > 1e-12 * np.abs(projection[:, :3]).max() ** 3,
        f"{where}: expected a projection of full rank, got a singular matrix; replace the file",
    )
    projection = projection * np.sign(determinant)
    K, rotation = _triangular(projection[:, :3])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = product(inverse(K), projection[:, 3])
    K = K / K[2, 2]
    require(
        abs(K[0, 1]) <= MOST_SKEW * K[0, 0],
        f"{where}: expected square pixel axes, got a skew of {K[0, 1]:.3g} at a focal length of"
        f" {K[0, 0]:.4g}; is it a DTU camera?",
    )
    fx, fy, cx, cy = (float(v) for v in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    lens = Lens(WIDTH, HEIGHT, fx, fy, cx, cy)
    return Calibration(checked_pose(viewmat, where), checked_lens(lens, where))


def _triangular(matrix: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Split `matrix` into K R, with K upper triangular, its diagonal positive, and R orthogonal.

    Gram-Schmidt from the last row up, twice, as one pass leaves rounding errors in R.
    """
    K, rotation = np.eye(3), matrix
    for _ in range(2):
        upper, rows = np.zeros((3, 3)), np.zeros((3, 3))
        for k in (2, 1, 0):
            rest = rotation[k]
            for j in range(k + 1, 3):
                upper[k, j] = (rest * rows[j]).sum()
                rest = rest - upper[k, j] * rows[j]
            upper[k, k] = np.sqrt(np.square(rest).sum())
            rows[k] = rest / upper[k, k]
        K, rotation = product(K, upper), rows
    return K, rotation
