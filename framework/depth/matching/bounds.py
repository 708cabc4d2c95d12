"""Between which depths to look for the surface."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from framework.depth.transfer import inside, project

if TYPE_CHECKING:
    from framework.types import TrainingSet

MIN_POINTS = 50  # fewer say little about the ends of the range
NEARER, FARTHER = 0.85, 1.3  # how far surfaces may lie beyond the triangulated points


def depth_bounds(training: TrainingSet, index: int) -> tuple[float, float]:
    """(nearest, farthest) depth to search in view `index`, in scene units.

    The bounds are the 0.5 % and 99.5 % quantiles of the sparse points inside the view's frustum.
    With fewer than `MIN_POINTS` points they are the scene's bounds. Both are widened.
    """
    camera = training.views[index].camera
    uvz = project(camera, training.points.xyz.numpy())
    depths = uvz[inside(camera, uvz), 2]
    if len(depths) < MIN_POINTS:
        return NEARER * training.near, FARTHER * training.far
    low, high = np.percentile(depths, [0.5, 99.5])
    return NEARER * float(low), FARTHER * float(high)
