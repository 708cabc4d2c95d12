"""Camera paths through a scene, from the poses of its training cameras.

- `spiral`: two turns around the mean camera, as wide as the cameras' spread, looking at one point,
  as in LLFF (Mildenhall et al. 2019); for cameras that look the same way.
- `orbit`: once around the point that all cameras look at, at their distance and height; for cameras
  all around.
- `spline`: through all training cameras in the order of their names, and back.

All paths end where they begin, so that a video can loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from framework.exports.opened import OpenedRun
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


SECONDS = {"spiral": 6.0, "orbit": 10.0}
SECONDS_EACH, MOST_SECONDS = 1.0, 20.0  # of a spline: for each camera on the way
WIDTH = 0.9  # quantile of the cameras' offsets that a spiral reaches
LEAST_WIDTH = 0.03  # of the distance looked at; a single camera moves too
WAVES = 2  # terms of an orbit's distance and height
DAMPED = 0.1  # as if a tenth of the cameras were on the mean circle
ALONG = 1e-6  # sine of the angle between viewing and up direction; below, they are parallel


def usual_seconds(kind: str, n: int) -> float:
    """Return the default duration of a flight past n cameras."""
    return SECONDS.get(kind) or min(MOST_SECONDS, max(4.0, 2 * SECONDS_EACH * (n - 1)))


def flight(run: OpenedRun, kind: str, n: int, lens: Camera) -> list[Camera]:
    """n cameras with the size and intrinsics of `lens`."""
    poses = rig([named.camera for named in run.cameras])
    make: dict[str, Callable[[], list[Array]]] = {
        "spiral": lambda: _spiral(poses, n, distance(run, poses, lens)),
        "orbit": lambda: _orbit(poses, n),
        "spline": lambda: _spline(poses, n),
    }
    return [_with_pose(lens, viewmat) for viewmat in make[kind]()]


def lens_of(cameras: Sequence[Camera], side: int | None) -> Camera:
    """A camera with the usual size of the training cameras, or `side` pixels as its longer side.

    It has their median focal length and a centred principal point. Sides are even for videos.
    """
    import torch

    sizes = [(camera.width, camera.height) for camera in cameras]
    width, height = max(sorted(set(sizes)), key=sizes.count)
    focal = np.median(
        [float(c.K[0, 0]) / c.width for c in cameras if (c.width, c.height) == (width, height)]
    )
    scale = 1.0 if side is None else side / max(width, height)
    w, h = (max(2, 2 * round(length * scale / 2)) for length in (width, height))
    K = torch.tensor([[focal * w, 0.0, w / 2], [0.0, focal * w, h / 2], [0.0, 0.0, 1.0]])
    return replace(cameras[0], K=K, width=w, height=h)


def looking(center: Array, forward: Array, down: Array) -> Array:
    """[4, 4] world-to-camera at `center`, with the image's down axis as close as possible to `down`
    (or to any axis, if it looks along `down`)."""
    z = unit(forward)
    across = np.cross(down, z)
    if np.linalg.norm(across) < ALONG:
        across = np.cross(np.eye(3)[np.abs(z).argmin()], z)
    x = unit(across)
    rotation = np.stack([x, np.cross(z, x), z])
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation, -rotation @ center
    return viewmat


def _with_pose(lens: Camera, viewmat: Array) -> Camera:
    import torch

    return replace(lens, viewmat=torch.from_numpy(viewmat))


def distance(run: OpenedRun, poses: Rig, lens: Camera) -> float:
    """Median depth in the middle of the mean camera's picture."""
    middle = looking(poses.centers.mean(axis=0), poses.forward.mean(axis=0), -poses.up)
    render = run.render(_with_pose(lens, middle), depth=True)
    h, w = lens.height // 4, lens.width // 4
    depth = render.expected_depth[h : -h or None, w : -w or None].numpy()
    visible = depth[depth > 0]
    return float(np.median(visible)) if len(visible) else 100 * run.near


def _spiral(poses: Rig, n: int, distance: float) -> list[Array]:
    center, forward = poses.centers.mean(axis=0), unit(poses.forward.mean(axis=0))
    axes = looking(center, forward, -poses.up)[:3, :3]
    spread = np.quantile(np.abs((poses.centers - center) @ axes.T), WIDTH, axis=0)
    wide = np.maximum(spread, [LEAST_WIDTH * distance, LEAST_WIDTH * distance / 2, 0.0])
    target = center + distance * forward
    viewmats = []
    for angle in 4 * np.pi * np.arange(n) / n:
        turn = np.array([np.cos(angle), np.sin(angle), np.sin(angle / 2)])
        place = center + (wide * turn) @ axes
        viewmats.append(looking(place, target - place, -poses.up))
    return viewmats


def _orbit(poses: Rig, n: int) -> list[Array]:
    """Distance and height are smooth functions of the angle, fitted to the cameras'."""
    angles, reach, height = around(poses.centers - poses.focus, poses.up)
    way = angles[0] + 2 * np.pi * np.arange(n) / n
    basis, wanted = _waves(angles), np.stack([reach, height], axis=1)
    weight = DAMPED * len(angles) * np.diag([0.0, *([1.0] * (2 * WAVES))])
    fitted = np.linalg.solve(basis.T @ basis + weight, basis.T @ wanted)
    at = _waves(way) @ fitted
    at = np.clip(at, wanted.min(axis=0), wanted.max(axis=0))
    first, second = plane(poses.up)
    viewmats = []
    for angle, (r, h) in zip(way, at, strict=True):
        offset = r * (np.cos(angle) * first + np.sin(angle) * second) + h * poses.up
        viewmats.append(looking(poses.focus + offset, -offset, -poses.up))
    return viewmats


def _waves(angles: Array) -> Array:
    """[n, 1 + 2 WAVES]: 1, and cosine and sine of the angles' multiples."""
    terms = [np.ones_like(angles)]
    for k in range(1, WAVES + 1):
        terms += [np.cos(k * angles), np.sin(k * angles)]
    return np.stack(terms, axis=1)


def _spline(poses: Rig, n: int) -> list[Array]:
    """There and back, slow at both ends. Positions and axes are interpolated by pieces of cubics
    that do not overshoot (Fritsch and Carlson 1980)."""
    from scipy.interpolate import PchipInterpolator

    if len(poses.centers) == 1:
        return [looking(poses.centers[0], poses.forward[0], poses.down[0])] * n
    steps = np.linalg.norm(np.diff(poses.centers, axis=0), axis=1)
    steps = np.maximum(steps, 1e-3 * max(float(steps.max()), 1e-9))  # a turn on the spot takes time
    marks = np.concatenate([[0.0], np.cumsum(steps)])
    keys = np.concatenate([poses.centers, poses.forward, poses.down], axis=1)
    along = marks[-1] * (1 - np.cos(2 * np.pi * np.arange(n) / n)) / 2
    at = PchipInterpolator(marks, keys)(along)
    return [looking(row[:3], row[3:6], row[6:]) for row in at]
