"""Small made-up runs with cameras and photos, for tests of the page."""

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from framework.records.cameras import write_cameras
from framework.records.run_files import write_photos
from framework.types import Camera, Gaussians, View
from tests.record.fakes import TAGS, fake_run, make_view

WIDTH, HEIGHT, NEAR = 64, 48, 0.2


def camera(turn: float, width: int = WIDTH, height: int = HEIGHT) -> Camera:
    """It stands 4 units from the origin, `turn` radians about the y axis, and looks at it; its
    principal point is off the middle."""
    cos, sin = math.cos(turn), math.sin(turn)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, :3] = torch.tensor([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    viewmat[2, 3] = 4.0
    K = torch.tensor([[0.9 * width, 0, 0.52 * width], [0, 0.95 * width, 0.47 * height], [0, 0, 1]])
    return Camera(viewmat, K, width, height)


def views(name: str = "train {:02d}") -> tuple[list[View], list[View]]:
    """Training views, of which a record of `fake_run` names the first, and its test views."""
    training = [View(name.format(0), camera(0.3), make_view(0).image)]
    tested = [
        View(make_view(i).name, camera(0.2 * i), make_view(i).image) for i in range(len(TAGS))
    ]
    return training, tested


def seen_run(folder: Path, **more: Any) -> Path:
    """The folder of a made-up run that has all that the page shows."""
    run = fake_run(folder, **more)
    training, tested = views()
    write_cameras(run, training, tested, NEAR)
    write_photos(run, training)
    return run


def scene_gaussians(n: int, banded: int, seed: int = 3) -> tuple[Gaussians, Tensor]:
    """Gaussians about the origin, the first `banded` with SH up to degree 3, and a background; some
    too faint, some needles, some near and large."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=draw)

    log_scales = -2.6 + 0.7 * normal(n, 3)
    log_scales[: n // 10, 0] += 1.5
    shN = 0.15 * normal(banded, 15, 3)
    gaussians = Gaussians(
        normal(n, 3), 3 * normal(n, 4), log_scales, 2 * normal(n), 0.8 * normal(n, 1, 3), shN
    )
    return gaussians, torch.tensor([0.55, 0.5, 0.3])
