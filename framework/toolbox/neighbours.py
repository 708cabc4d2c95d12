"""Which Gaussians are next to each other. Light to import."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


def nearest_distance(points: Tensor, others: Tensor) -> Tensor:
    """[N] distance of each of `points` [N, 3] to the nearest of `others` [M, 3]; inf if M is 0."""
    import torch
    from scipy.spatial import cKDTree

    if len(others) == 0:
        return torch.full((len(points),), float("inf"))
    distances, _ = cKDTree(others.numpy()).query(points.numpy())
    return torch.from_numpy(distances).float()


def nearest_others(points: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """(distances [N, k'], rows [N, k'] int64) of the k' = min(k, N - 1) nearest others of each of
    `points` [N, 3], the nearest first. Of points in one place any may count as the other."""
    import torch
    from scipy.spatial import cKDTree

    n = len(points)
    k = min(k, n - 1)
    if k < 1:
        return torch.zeros(n, 0), torch.zeros(n, 0, dtype=torch.int64)
    places = points.double().numpy()
    distances, rows = (torch.from_numpy(a) for a in cKDTree(places).query(places, k=k + 1))
    # a point is its own nearest; where others share its place it may stand further down the list
    itself = rows == torch.arange(n)[:, None]
    itself[:, -1] |= ~itself.any(1)
    return distances[~itself].view(n, k).float(), rows[~itself].view(n, k)
