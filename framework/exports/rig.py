"""The arrangement of the training cameras: focus, up direction, and whether they are all around,
side by side, or along a path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from framework.types import Camera

Array = NDArray[np.float64]

PARALLEL = 0.9  # length of the mean viewing direction; cameras within about 25 degrees of it
GAP = 2.4  # radians; the largest stretch without a camera in a circle of them (138 degrees)
TILTED = 0.3  # length of the mean up direction; below, there is no common one


@dataclass(frozen=True)
class Rig:
    """centers, down, forward: [n, 3], of the cameras, in the world."""

    centers: Array
    down: Array
    forward: Array

    @property
    def up(self) -> Array:
        """[3] mean up direction; that of the first camera if they have none in common, as on a
        flight to and fro above a field."""
        mean = self.down.mean(axis=0)
        return unit(-(self.down[0] if np.linalg.norm(mean) < TILTED else mean))

    @property
    def focus(self) -> Array:
        """[3] point nearest to all optical axes (least squares, with a weak pull to the mean camera
        for parallel axes)."""
        across = np.eye(3) - self.forward[:, :, None] * self.forward[:, None, :]
        weak = 1e-3 * len(across) * np.eye(3)
        middle = self.centers.mean(axis=0)
        right_side = np.einsum("nij,nj->i", across, self.centers) + weak @ middle
        point: Array = np.linalg.solve(across.sum(axis=0) + weak, right_side)
        return point

    @property
    def kind(self) -> str:
        """The suitable path: `orbit`, `spiral` or `spline`."""
        if len(self.centers) < 2 or np.linalg.norm(self.forward.mean(axis=0)) > PARALLEL:
            return "spiral"
        tilted = np.linalg.norm(self.down.mean(axis=0)) < TILTED
        offset = self.centers - self.focus
        ahead = (self.forward * -offset).sum(axis=1) > 0
        if len(self.centers) < 3 or tilted or not ahead.all():
            return "spline"
        return "orbit" if self.largest_gap <= GAP else "spline"

    @property
    def largest_gap(self) -> float:
        """Largest angle between neighbours around the focus, in radians."""
        angles = np.sort(around(self.centers - self.focus, self.up)[0])
        return float(np.diff(np.append(angles, angles[0] + 2 * np.pi)).max())


def rig(cameras: Sequence[Camera]) -> Rig:
    """The rig of the cameras."""
    views = np.stack([camera.viewmat.numpy() for camera in cameras])
    rotation = views[:, :3, :3]
    centers = -np.einsum("nji,nj->ni", rotation, views[:, :3, 3])
    return Rig(centers, rotation[:, 1], rotation[:, 2])


def unit(vector: Array) -> Array:
    """Normalise along the last axis."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    result: Array = vector / np.maximum(length, 1e-12)
    return result


def plane(up: Array) -> tuple[Array, Array]:
    """Two unit vectors [3] that complete `up` to a right-handed system."""
    first = unit(np.cross(up, np.eye(3)[np.abs(up).argmin()]))
    return first, np.cross(up, first)


def around(offsets: Array, up: Array) -> tuple[Array, Array, Array]:
    """Angle, distance from the axis and height of each of the offsets [n, 3]."""
    first, second = plane(up)
    a, b = offsets @ first, offsets @ second
    return np.arctan2(b, a), np.hypot(a, b), offsets @ up
