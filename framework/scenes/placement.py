"""Where test cameras stand beside the training cameras: between them, or out of their reach."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ROUNDS, PRECISION = 1000, 1e-3  # of the search for the hull's closest point
REACH = 0.25  # camera spacings; handheld and robot-held paths leave their hull by less

INTERPOLATING, EXTRAPOLATING = ("interpolating",), ("extrapolating",)


def placement(centers: NDArray[np.float64], training: NDArray[np.float64]) -> list[tuple[str, ...]]:
    """The tag of each camera at `centers` [M, 3]: interpolating within `REACH` spacings of the
    convex hull of the `training` cameras [K, 3], else extrapolating; none where fewer than two
    training cameras stand apart. A spacing is the median distance to the nearest other one."""
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates near the largest float
        distances = np.linalg.norm(training[:, None] - training, axis=2)
        np.fill_diagonal(distances, np.inf)
        spacing = float(np.median(distances.min(axis=1)))
        if not 0 < spacing < np.inf:
            return [()] * len(centers)
        near = [_hull_distance((training - center) / spacing) <= REACH for center in centers]
    return [INTERPOLATING if inside else EXTRAPOLATING for inside in near]


def _hull_distance(points: NDArray[np.float64]) -> float:
    """Distance of the origin from the convex hull of [K, 3] points. Gilbert (1966): go from the
    closest point so far towards the corner that is farthest in the origin's direction, as far as
    that helps; no import of scipy.optimize, which takes half a second."""
    closest = points[np.linalg.norm(points, axis=1).argmin()]
    for _ in range(ROUNDS):
        corner = points[(points @ closest).argmin()]
        edge = closest - corner
        if closest @ edge <= PRECISION * (closest @ closest) or not edge.any():
            break
        closest = closest - min(1.0, closest @ edge / (edge @ edge)) * edge
    return float(np.linalg.norm(closest))
