"""The camera rig of the embedded scene: forward-facing, like a hand-held LLFF sweep.

Positions are in units of `spread` on the plane z = 0, viewing directions converge on a far point.
"""

import numpy as np
from numpy.typing import NDArray

from framework.compute.rng import stream
from framework.scenes.embedded.vectors import Vector, looking

FOCAL_WIDTHS = 0.9  # focal length in units of the image width: 58 degrees across
FOCUS: Vector = (0.0, -0.05, 6.5)

# four inside the hull of the default three training cameras, four outside
TEST_POSITIONS: tuple[Vector, ...] = (
    (0.0, 0.0, 0.0),
    (-0.45, -0.2, 0.0),
    (0.45, -0.2, 0.0),
    (0.0, 0.3, 0.0),
    (-1.3, 0.1, 0.0),
    (1.3, 0.1, 0.0),
    (0.1, -1.0, 0.0),
    (0.3, 0.1, 0.9),
)


def training_positions(n: int) -> list[Vector]:
    """n positions in a zigzag from left to right; a single camera is above the centre."""
    if n == 1:
        return [(0.0, -0.5, 0.0)]
    return [(2.0 * k / (n - 1) - 1.0, 0.5 if k % 2 else -0.5, 0.0) for k in range(n)]


def pose(position: Vector, spread: float) -> NDArray[np.float64]:
    """[3, 4] camera-to-world of the camera at `position` (in units of `spread` metres)."""
    center = (position[0] * spread, position[1] * spread, position[2] * spread)
    forward = (FOCUS[0] - center[0], FOCUS[1] - center[1], FOCUS[2] - center[2])
    x, y, z = looking(forward)
    return np.array([[x[k], y[k], z[k], center[k]] for k in range(3)])


def perturbed(poses: NDArray[np.float64], angle: float) -> list[NDArray[np.float64]]:
    """Perturb camera-to-world poses [n, 3, 4].

    Each camera turns about its x and y axes and moves along them, by four independent normal draws,
    which depend on neither a run's seed nor the angle. The turn is the Cayley map, which needs no
    library sine.

    Args:
        poses: the exact poses.
        angle: standard deviation of a turn in radians. A move shifts what is at `FOCUS` as much, so
            an error of x pixels displaces it by about x sqrt(2) pixels along each image axis.
    """
    draws = stream(0, "embedded/pose_noise").standard_normal((len(poses), 4))
    return [
        _moved(pose, *(angle * d for d in draw.tolist()))
        for pose, draw in zip(poses, draws, strict=True)
    ]


def _moved(
    pose: NDArray[np.float64], about_x: float, about_y: float, right: float, down: float
) -> NDArray[np.float64]:
    a, b = 0.5 * about_x, 0.5 * about_y
    norm = 1.0 + a * a + b * b
    turn = np.array(
        [
            [1.0 + a * a - b * b, 2.0 * a * b, 2.0 * b],
            [2.0 * a * b, 1.0 - a * a + b * b, -2.0 * a],
            [-2.0 * b, 2.0 * a, 1.0 - a * a - b * b],
        ]
    )
    columns = [sum(pose[:, i] * turn[i, k] for i in range(3)) / norm for k in range(3)]
    center = pose[:, 3] + FOCUS[2] * (right * pose[:, 0] + down * pose[:, 1])
    return np.stack([*columns, center], axis=1)
