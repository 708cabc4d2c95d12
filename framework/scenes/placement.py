"""Tags test cameras as interpolating or extrapolating with respect to the training cameras."""

import numpy as np
from numpy.typing import NDArray

ROUNDS = 5000  # limit of the search; some hundred are needed at the border
ONE_PLACE = 1e-3  # of the largest distance; closer cameras count as one position
REACH = 0.25  # camera spacings; hand-held and robot paths leave their hull by less

INTERPOLATING, EXTRAPOLATING = ("interpolating",), ("extrapolating",)


def placement(centers: NDArray[np.float64], training: NDArray[np.float64]) -> list[tuple[str, ...]]:
    """The tag of each camera at `centers` [M, 3].

    Interpolating: within `REACH` spacings of the convex hull of the `training` cameras [K, 3]. A
    spacing is the median distance to the nearest other position. No tags if all
    cameras are at one position.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # coordinates near the largest float
        distances = np.linalg.norm(training[:, None] - training, axis=2)
        distances[distances <= ONE_PLACE * distances.max()] = np.inf
        spacing = float(np.median(distances.min(axis=1)))
        if not 0 < spacing < np.inf:
            return [()] * len(centers)
        near = [_near_hull((training - center) / spacing) for center in centers]
    return [INTERPOLATING if inside else EXTRAPOLATING for inside in near]


def _near_hull(points: NDArray[np.float64]) -> bool:
    """Whether the convex hull of [K, 3] points comes within `REACH` of the origin.

    Gilbert (1966): move from the closest point so far towards the corner farthest in the origin's
    direction, until it is close enough or a plane separates hull and origin. scipy.optimize is not
    used, as its import takes half a second.
    """
    closest = points[np.linalg.norm(points, axis=1).argmin()]
    for _ in range(ROUNDS):
        distance = float(np.linalg.norm(closest))
        corner = points[(points @ closest).argmin()]
        if distance <= REACH or closest @ corner > REACH * distance:
            break
        edge = closest - corner
        closest = closest - min(1.0, closest @ edge / (edge @ edge)) * edge
    return float(np.linalg.norm(closest)) <= REACH
