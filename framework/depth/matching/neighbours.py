"""Which training views to match a view with, and between which depths to look for the surface.

A good partner sees the same surface under a triangulation angle that is wide enough to measure and
narrow enough to look alike. The score of a pair is a sum over common points:

    g(angle) = min(1, angle / 3 deg) exp(-(max(0, angle - 15 deg) / 20 deg)^2)

It follows Yao et al. (MVSNet, ECCV 2018, section 4.1), but is wider, as sparse views are far apart.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from framework.compute import portable
from framework.depth.transfer import inside, project

if TYPE_CHECKING:
    from framework.types import Camera, TrainingSet

MIN_POINTS = 50  # fewer say little about the ends of the range
NEARER, FARTHER = 0.85, 1.3  # how far surfaces may lie beyond the triangulated points
MIN_SHARED = 10  # sparse points a view must share with some other for them to decide
RELATIVE_FLOOR = 0.1  # a partner scores at least this share of the best partner's score
WEAK_FLOOR = 0.02  # that share for the second partner
GRID, LEVELS = 16, 3  # pixels per side and inverse depths of the grid used without sparse points


def depth_bounds(training: TrainingSet, index: int) -> tuple[float, float]:
    """(nearest, farthest) depth to search in view `index`, in scene units.

    A bound that the user gave is kept. The others are the 0.5 % and 99.5 % quantiles of the sparse
    points inside the view's frustum, widened. They are the scene's bounds, widened, if these points
    are fewer than `MIN_POINTS` or beyond the user's bound.
    """
    near_given, far_given = training.given
    scene = (
        training.near if near_given else NEARER * training.near,
        training.far if far_given else FARTHER * training.far,
    )
    camera = training.views[index].camera
    uvz = project(camera, training.points.xyz.numpy())
    depths = uvz[inside(camera, uvz), 2]
    if len(depths) < MIN_POINTS:
        return scene
    low, high = np.percentile(depths, [0.5, 99.5])
    near = scene[0] if near_given else NEARER * float(low)
    far = scene[1] if far_given else FARTHER * float(high)
    return (near, far) if near < far else scene


def angle_weight(xyz: NDArray[np.float64], a: Camera, b: Camera) -> NDArray[np.float64]:
    """[M] g(angle) of the rays from points [M, 3] to the centres of two cameras."""
    rays = [camera.center.numpy() - xyz for camera in (a, b)]
    units = [ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays]
    apart, along = (np.sqrt(np.square(v).sum(1)) for v in (units[0] - units[1], sum(units)))
    angle = np.degrees(2 * portable.arctan(apart / np.maximum(along, 1e-300)))
    narrow = np.minimum(1.0, angle / 3.0)
    wide = np.square(np.maximum(0.0, angle - 15.0) / 20.0)
    weight: NDArray[np.float64] = narrow * portable.exp(-wide)
    return weight


def grid_points(camera: Camera, near: float, far: float) -> NDArray[np.float64]:
    """[GRID^2 LEVELS, 3] world points over the image at evenly spaced inverse depths."""
    steps = (np.arange(GRID) + 0.5) / GRID
    u, v = np.meshgrid(steps * camera.width, steps * camera.height)
    pixels = np.stack([u.ravel(), v.ravel(), np.ones(GRID * GRID)])
    rays = portable.product(portable.inverse(camera.K.numpy()), pixels).T
    depths = 1.0 / np.linspace(1.0 / far, 1.0 / near, LEVELS)
    pose = camera.viewmat.numpy()
    points: NDArray[np.float64] = np.concatenate([rays * z for z in depths]) - pose[:3, 3]
    return portable.product(points, pose[:3, :3])


def _shared_scores(training: TrainingSet, index: int) -> NDArray[np.float64]:
    """[n] scores of all views against `index` from shared sparse points; zeros if too few."""
    xyz, visible = training.points.xyz.numpy(), training.points.visible.numpy()
    camera = training.views[index].camera
    scores = np.zeros(len(training.views))
    most = 0
    for other, view in enumerate(training.views):
        shared = visible[:, index] & visible[:, other]
        if other != index:
            scores[other] = angle_weight(xyz[shared], camera, view.camera).sum()
            most = max(most, int(shared.sum()))
    return scores if most >= MIN_SHARED else np.zeros_like(scores)


def _frustum_scores(
    training: TrainingSet, index: int, bounds: tuple[float, float]
) -> NDArray[np.float64]:
    """[n] scores of all views against `index` from the overlap of their frusta."""
    camera = training.views[index].camera
    xyz = grid_points(camera, *bounds)
    scores = np.zeros(len(training.views))
    for other, view in enumerate(training.views):
        if other != index:
            common = xyz[inside(view.camera, project(view.camera, xyz))]
            scores[other] = angle_weight(common, camera, view.camera).sum()
    return scores


def choose_neighbours(
    training: TrainingSet, index: int, limit: int, bounds: tuple[float, float]
) -> list[int]:
    """The up to `limit` best partners of view `index`, best first; empty if nothing overlaps.

    The second one may be weak: a single partner leaves what it does not see without a match.

    Judged by the sparse points both views see, or, where those are too few, by how much of the
    frustum between the depth `bounds` the other view covers.
    """
    scores = _shared_scores(training, index)
    if scores.max() <= 0:
        scores = _frustum_scores(training, index, bounds)
    order = np.argsort(-scores, kind="stable")[:limit]
    floors = [WEAK_FLOOR if rank < 2 else RELATIVE_FLOOR for rank in range(len(order))]
    return [
        int(other)
        for other, floor in zip(order, floors, strict=True)
        if scores[other] >= max(floor * scores.max(), 1e-3)
    ]
