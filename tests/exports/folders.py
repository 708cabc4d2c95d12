"""Folders of runs with a few Gaussians, for whoever reads them."""

import math
from pathlib import Path

import numpy as np
import torch

from framework.exports.flight import looking
from framework.records.cameras import write_cameras
from framework.records.ply import write_ply
from framework.types import Camera, Gaussians, View

WIDTH, HEIGHT, FOCAL = 48, 36, 50.0


def some_gaussians(n: int = 40, terms: int = 15) -> Gaussians:
    """Around the origin, large enough to be seen."""
    random = torch.Generator().manual_seed(3)

    def draw(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random)

    return Gaussians(
        means=0.5 * draw(n, 3),
        quats=draw(n, 4),
        log_scales=-1.8 + 0.3 * draw(n, 3),
        opacity_logits=draw(n),
        sh0=draw(n, 1, 3),
        shN=0.2 * draw(n, terms, 3),
    )


def camera_at(
    center: tuple[float, float, float], up: tuple[float, float, float] = (0, -1, 0)
) -> Camera:
    """Looks at the origin."""
    place = np.array(center, dtype=np.float64)
    viewmat = looking(place, -place, -np.array(up, dtype=np.float64))
    K = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    return Camera(torch.from_numpy(viewmat), K, WIDTH, HEIGHT)


def side_by_side(n: int = 4) -> list[Camera]:
    """Cameras that look the same way, nearly."""
    return [camera_at((0.3 * k - 0.4, 0.1 * (k % 2), -4)) for k in range(n)]


def all_around(n: int = 8, up: tuple[float, float, float] = (0, -1, 0)) -> list[Camera]:
    """A circle of cameras, above the middle."""
    return [
        camera_at((3 * math.cos(a), -1.0, 3 * math.sin(a)), up)
        for a in 2 * math.pi * np.arange(n) / n
    ]


def run_folder(folder: Path, cameras: list[Camera], gaussians: Gaussians | None = None) -> Path:
    """A finished run, as far as exports read it."""
    folder.mkdir()
    views = [View(f"a/{k}.jpg", c, torch.zeros(3, HEIGHT, WIDTH)) for k, c in enumerate(cameras)]
    write_cameras(folder, views[1:], views[:1], 0.02)
    write_ply(
        folder / "point_cloud.ply",
        some_gaussians() if gaussians is None else gaussians,
        torch.tensor([0.25, 0.5, 0.75]),
    )
    return folder
