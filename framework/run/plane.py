"""Three small made-up views: kernels are compiled on them, and tests train on them."""

from __future__ import annotations

import numpy as np
import torch

from framework.compute.rng import stream
from framework.types import Camera, DepthMap, Gaussians, SparsePoints, TrainingSet, View

WIDTH, HEIGHT, FOCAL, DISTANCE, STEP = 64, 48, 60.0, 3.0, 0.2


def textured_plane(sh_degree: int) -> tuple[TrainingSet, tuple[DepthMap, ...], Gaussians]:
    """Three cameras side by side before a textured plane, with exact depth and 200 Gaussians."""
    texture = stream(0, "warmup").random((3, HEIGHT + 4, 2 * WIDTH))
    shift = round(FOCAL * STEP / DISTANCE)
    K = torch.tensor([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
    views = []
    for i in range(3):
        viewmat = torch.eye(4)
        viewmat[0, 3] = -STEP * i
        pixels = texture[:, :HEIGHT, i * shift : i * shift + WIDTH]
        image = torch.from_numpy(np.ascontiguousarray(pixels, np.float32))
        views.append(View(f"plane-{i}", Camera(viewmat, K, WIDTH, HEIGHT), image))
    rng = stream(0, "warmup/points")
    xyz = rng.uniform([-1.0, -1.0, DISTANCE - 0.05], [1.4, 1.0, DISTANCE + 0.05], (200, 3))
    points = SparsePoints(
        torch.from_numpy(xyz), torch.full((200, 3), 0.5), torch.ones(200, 3, dtype=torch.bool)
    )
    full = DepthMap(torch.full((HEIGHT, WIDTH), DISTANCE), torch.ones(HEIGHT, WIDTH))
    training = TrainingSet("warm-up", tuple(views), points, 0.5 * DISTANCE, 2 * DISTANCE)
    terms = (sh_degree + 1) ** 2 - 1
    gaussians = Gaussians(
        torch.from_numpy(xyz.astype(np.float32)),
        torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(200, 1),
        torch.full((200, 3), -3.0),
        torch.zeros(200),
        torch.zeros(200, 1, 3),
        torch.zeros(200, terms, 3),
    )
    return training, (full,) * 3, gaussians
