"""An analytic scene: one slanted plane with a band-limited texture, seen by unlike cameras.

The cameras differ in size, focal lengths (non-square pixels) and principal point (off centre).
"""

import numpy as np
import torch

from framework.compute.rng import stream
from framework.types import Camera, SparsePoints, TrainingSet, View

NORMAL = np.array([0.25, -0.15, -1.0])
OFFSET = -5.0  # NORMAL . X = OFFSET: about five units in front of the cameras
NEAR, FAR = 3.5, 7.5


def texture(points: np.ndarray) -> np.ndarray:
    """[..., 3] world points to [3, ...] colours: a sum of 60 waves of 0.12 to 1 unit."""
    rng = stream(7, "tests/depth/plane")
    directions = rng.normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    waves = directions * (2 * np.pi / rng.uniform(0.12, 1.0, (60, 1)))
    phases = rng.uniform(0, 2 * np.pi, (3, 60))
    swing = np.cos((points @ waves.T)[None] + phases[:, None, None, :]).mean(-1)
    return np.clip(0.5 + 2.0 * swing, 0, 1)


def camera(center: tuple[float, float, float], size: tuple[int, int], focal: float) -> Camera:
    """A camera that looks roughly along z, turned by a few degrees about y."""
    angle = 0.05 * center[0]
    rotation = np.array(
        [[np.cos(angle), 0, -np.sin(angle)], [0, 1, 0], [np.sin(angle), 0, np.cos(angle)]]
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ np.array(center)
    width, height = size
    K = np.array([[focal, 0, 0.46 * width], [0, 1.1 * focal, 0.55 * height], [0, 0, 1]])
    return Camera(torch.from_numpy(pose), torch.from_numpy(K), width, height)


def plane_depth(of: Camera) -> np.ndarray:
    """[H, W] exact depth of the plane."""
    return _intersect(of)[1]


def _intersect(of: Camera) -> tuple[np.ndarray, np.ndarray]:
    """World points [H, W, 3] and depth [H, W] at the pixel centres."""
    y, x = np.mgrid[: of.height, : of.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(of.K.numpy()).T
    rays = rays @ of.viewmat[:3, :3].numpy()
    center = of.center.numpy()
    depth = (OFFSET - NORMAL @ center) / (rays @ NORMAL)
    return center + rays * depth[..., None], depth


def view(name: str, of: Camera) -> View:
    points, depth = _intersect(of)
    return View(
        name,
        of,
        torch.from_numpy(texture(points).astype(np.float32)),
        depth=torch.from_numpy(depth.astype(np.float32)),
    )


def no_points(n_views: int) -> SparsePoints:
    return SparsePoints(
        torch.zeros((0, 3), dtype=torch.float64),
        torch.zeros((0, 3)),
        torch.zeros((0, n_views), dtype=torch.bool),
    )


def plane_scene(n_points: int = 0) -> TrainingSet:
    """Three views of the plane; with `n_points` exact points that all of them see."""
    views = (
        view("left.JPG", camera((-0.5, 0.0, 0.0), (96, 72), 90.0)),
        view("middle.JPG", camera((0.0, 0.1, 0.1), (104, 80), 95.0)),
        view("right.JPG", camera((0.5, 0.0, 0.0), (96, 72), 85.0)),
    )
    if n_points == 0:
        return TrainingSet("plane", views, no_points(3), NEAR, FAR)
    rng = stream(1, "tests/depth/points")
    xy = rng.uniform(-0.8, 0.8, (n_points, 2))
    z = (OFFSET - xy @ NORMAL[:2]) / NORMAL[2]
    points = SparsePoints(
        torch.from_numpy(np.column_stack([xy, z])),
        torch.zeros((n_points, 3)),
        torch.ones((n_points, 3), dtype=torch.bool),
    )
    return TrainingSet("plane", views, points, NEAR, FAR)
