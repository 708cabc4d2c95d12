"""A ray-traced stage for warping: a slanted textured wall behind a textured square.

World axes as a camera's (x right, y down, z forward). The wall is z = 6 + 0.3 x, the square
|x|, |y| <= 0.8 at z = 3. `unit` multiplies every length; the images do not depend on it.
"""

import numpy as np
import torch

from framework.types import Camera, DepthMap, View

WALL, SLANT, SQUARE, HALF = 6.0, 0.3, 3.0, 0.8


def camera(
    x: float = 0.0,
    y: float = 0.0,
    z: float = 0.0,
    *,
    yaw: float = 0.0,
    unit: float = 1.0,
    size: tuple[int, int] = (160, 120),
) -> Camera:
    """A camera at (x, y, z) units, turned by `yaw` radians about the vertical axis."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    rotation = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -rotation @ (unit * np.array([x, y, z]))
    width, height = size
    K = np.array([[width, 0, 0.5 * width], [0, width, 0.5 * height], [0, 0, 1.0]])
    return Camera(torch.from_numpy(viewmat), torch.from_numpy(K), width, height)


def photograph(cam: Camera, *, unit: float = 1.0, samples: int = 4, square: bool = True) -> View:
    """The stage seen by `cam`, `samples`^2 rays per pixel; depth through the pixel centres."""
    steps = (np.arange(samples) + 0.5) / samples
    colors = [_trace(cam, unit, dx, dy, square)[0] for dy in steps for dx in steps]
    image = torch.from_numpy(np.mean(colors, axis=0).astype(np.float32))
    depth = torch.from_numpy(_trace(cam, unit, 0.5, 0.5, square)[1].astype(np.float32))
    return View("stage", cam, image, depth=depth)


def exact(view: View) -> DepthMap:
    """The exact depth of a view of the stage, fully trusted."""
    assert view.depth is not None
    return DepthMap(view.depth, torch.ones_like(view.depth))


def _trace(
    cam: Camera, unit: float, dx: float, dy: float, square: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Colours [3, H, W] and depth [H, W] along the rays through (col + dx, row + dy)."""
    rotation, center = cam.viewmat[:3, :3].numpy(), cam.center.numpy() / unit
    row, col = np.mgrid[0 : cam.height, 0 : cam.width]
    pixels = np.stack([col + dx, row + dy, np.ones(row.shape)])
    rays = np.einsum("ij,jhw->ihw", rotation.T @ np.linalg.inv(cam.K.numpy()), pixels)
    z = (WALL + SLANT * center[0] - center[2]) / (rays[2] - SLANT * rays[0])
    color = _texture(center[0] + z * rays[0], center[1] + z * rays[1], 0.0)
    if square:
        z_near = (SQUARE - center[2]) / rays[2]
        x, y = center[0] + z_near * rays[0], center[1] + z_near * rays[1]
        hit = (np.abs(x) <= HALF) & (np.abs(y) <= HALF)
        z = np.where(hit, z_near, z)
        color = np.where(hit, _texture(2 * x, 2 * y, 2.0), color)
    return color, z * unit


def _texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    """A band-limited texture, [3, ...] in [0.1, 0.9], about 10 pixels per period and longer."""
    waves = [
        0.2 * np.sin(9 * x + 3 * y + c + phase) + 0.2 * np.cos(4 * x - 7 * y + 2 * c + phase)
        for c in range(3)
    ]
    return 0.5 + np.stack(waves)
