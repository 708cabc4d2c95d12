"""A scene with exact depth: a wall at z = 6 and a square board in front of it at z = 4."""

import numpy as np
import torch

from framework.geometry import perturbed, unproject
from framework.types import Camera, DepthMap, SparsePoints, TrainingSet, View

WALL_Z, BOARD_Z, BOARD_HALF = 6.0, 4.0, 0.5


def camera(x: float, turn: float = 0.0, width: int = 64, height: int = 48) -> Camera:
    """At (x, 0, 0), looking along +z, turned about its y axis; fx != fy, centre off the middle."""
    K = torch.tensor([[60.0, 0.0, width / 2 - 1.5], [0.0, 55.0, height / 2 + 1.0], [0.0, 0.0, 1.0]])
    start = Camera(torch.eye(4), K.double(), width, height)
    return perturbed(start, torch.tensor([0.0, turn, 0.0]), torch.tensor([x, 0.0, 0.0]))


def exact_depth(view: Camera) -> torch.Tensor:
    """[H, W] float64 camera-space depth of the nearer of board and wall at the pixel centres."""
    one = torch.ones(view.height, view.width, dtype=torch.float64)
    rays = unproject(one, view) - view.center
    board, wall = ((z - view.center[2]) / rays[..., 2] for z in (BOARD_Z, WALL_Z))
    hit = view.center + board[..., None] * rays
    on_board = (hit[..., :2].abs() < BOARD_HALF).all(-1)
    return torch.where(on_board, board, wall)


def texture(points: torch.Tensor) -> torch.Tensor:
    """[3, H, W] float32 colours of world points [H, W, 3]: stripes on the left half only."""
    x, y = points[..., 0], points[..., 1]
    stripes = torch.where(x < 0, 0.5 + 0.5 * torch.sin(12 * x), 0.5)
    return torch.stack([stripes, 0.5 + 0.05 * y.clamp(-5, 5), torch.full_like(x, 0.25)]).float()


def scene(cameras: list[Camera]) -> tuple[TrainingSet, tuple[DepthMap, ...]]:
    """The training set those cameras see, with exact, fully confident depth."""
    views, depths = [], []
    for index, view in enumerate(cameras):
        depth = exact_depth(view)
        views.append(View(f"view{index}", view, texture(unproject(depth, view))))
        depths.append(DepthMap(depth.float(), torch.ones(depth.shape)))
    return TrainingSet("synthetic", tuple(views), no_points(len(views)), 3.0, 8.0), tuple(depths)


def three_views() -> tuple[TrainingSet, tuple[DepthMap, ...]]:
    """Two outer views, one of another size, and a central one, listed second."""
    return scene([camera(-0.6, 0.05), camera(0.05), camera(0.7, -0.06, 80, 60)])


def no_points(n_views: int) -> SparsePoints:
    return points(np.zeros((0, 3)), n_views)


def points(xyz: np.ndarray, n_views: int = 2) -> SparsePoints:
    """Grey points that all views see."""
    n = len(xyz)
    return SparsePoints(
        torch.from_numpy(np.asarray(xyz, dtype=np.float64)),
        torch.full((n, 3), 0.5),
        torch.ones(n, n_views, dtype=torch.bool),
    )
