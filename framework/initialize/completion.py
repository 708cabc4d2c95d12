"""A surface for the pixels without consistent depth: what one view alone sees, far backgrounds.

Without one, nothing but the background colour stands there, and no Gaussian is near to learn what
the photo shows. The guess continues the depth around the pixel, that of the sparse points included,
and prefers the farther where near and far meet, since what stereo misses is mostly behind. Then it
moves back along its ray until no training view looks through it and it leaves the ball in which the
cameras stand: other cameras look through that ball, and what floats in it hides the scene.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.ndimage import zoom

from framework.geometry import project, unproject
from framework.initialize.fusion import (
    DepthView,
    SurfacePixels,
    by_centrality,
    compare,
    confident_view,
    joined,
    surface_pixels,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from torch import Tensor

    from framework.types import DepthMap, TrainingSet

    Array = NDArray[np.float64]

FAR_PREFERENCE = 2.0  # weight of a known pixel: its depth to this power
STEPS = np.geomspace(1.0, 8.0, 9)  # tried factors on a guessed depth, nearest first
BALL = 1.5  # radius of the cameras' ball, in scene extents
SAME_GUESS = 0.15  # relative depth difference up to which two views guess the same surface


def complete(
    training: TrainingSet, depth: tuple[DepthMap, ...], tolerance: float, detail: float
) -> SurfacePixels:
    """The guessed pixels of all training views, from the most central view to the outermost one.

    A pixel stays out where another view has a consistent or an earlier one a guessed surface, or
    where some view looks through every place on its ray. tolerance, detail: as in `fusion.fuse`.
    """
    order = by_centrality([view.camera for view in training.views])
    maps = {i: confident_view(training.views[i], depth[i]) for i in order}
    guesses: list[DepthView] = []
    parts = []
    for i in order:
        others = [maps[j] for j in order if j != i]
        guess = _guessed(training, i, maps[i], others, guesses, tolerance)
        chosen = guess > 0
        xyz = unproject(guess, maps[i].camera)[chosen]
        parts.append(surface_pixels(training.views[i], xyz, guess[chosen], chosen, detail))
        near = torch.where(chosen, guess, torch.inf)
        guesses.append(DepthView(maps[i].camera, guess, near))
    return joined(parts)


def _guessed(
    training: TrainingSet,
    index: int,
    own: DepthView,
    others: Sequence[DepthView],
    guesses: Sequence[DepthView],
    tolerance: float,
) -> Tensor:
    """[H, W] guessed depth of view `index` where it has none of its own; 0 where it stays out."""
    start = torch.from_numpy(filled(_with_points(training, index, own)))
    empty, mask = (own.depth == 0) & (start > 0), training.views[index].mask
    if mask is not None:
        empty &= mask > 0.5
    center = own.camera.center
    rays = unproject(torch.ones_like(start), own.camera)[empty] - center
    z = _pushed_back(training, center, rays, start[empty], others, tolerance)
    xyz, keep = center + z[:, None] * rays, z > 0
    for seen in others:
        keep &= ~compare(xyz, seen, tolerance)[0]
    for seen in guesses:
        keep &= ~compare(xyz, seen, SAME_GUESS)[0]
    result = torch.zeros_like(start)
    result[empty] = torch.where(keep, z, 0.0)
    return result


def _with_points(training: TrainingSet, index: int, own: DepthView) -> Array:
    """[H, W] the consistent depth and, where it has none, that of the sparse points it sees."""
    depth: Array = own.depth.numpy().copy()
    points = training.points
    uv, z = project(points.xyz[points.visible[:, index]], own.camera)
    inside = (z > 0) & (uv >= 0).all(1)
    inside &= (uv[:, 0] < own.camera.width) & (uv[:, 1] < own.camera.height)
    column, row = uv[inside].long().unbind(1)
    at = (row.numpy(), column.numpy())
    depth[at] = np.where(depth[at] > 0, depth[at], z[inside].numpy())
    return depth


def _pushed_back(
    training: TrainingSet,
    center: Tensor,
    rays: Tensor,
    depth: Tensor,
    others: Sequence[DepthView],
    tolerance: float,
) -> Tensor:
    """[P] `depth` times the smallest of `STEPS` that puts center + z rays [P, 3] outside the ball
    of the cameras and before no surface of another view; 0 where none does."""
    centers = torch.stack([view.camera.center for view in training.views])
    middle, radius = centers.mean(0), BALL * training.extent
    chosen, left = torch.zeros_like(depth), torch.arange(len(depth))
    for factor in STEPS:
        z = factor * depth[left]
        xyz = center + z[:, None] * rays[left]
        free = (xyz - middle).norm(dim=1) >= radius
        for seen in others:
            free[free.clone()] = ~compare(xyz[free], seen, tolerance)[1]
        chosen[left[free]] = z[free]
        left = left[~free]
    return chosen


def filled(depth: Array) -> Array:
    """[H, W] depth, its unknown pixels (0) filled from the known ones around them; all zeros stay.

    Pull-push (Gortler et al., SIGGRAPH 1996, section 3.4) of inverse depth, weighted by depth^2.
    """
    known = depth > 0
    if known.all() or not known.any():
        return depth
    safe = np.where(known, depth, 1.0)
    weight = np.where(known, (safe / safe[known].max()) ** FAR_PREFERENCE, 0.0)
    return np.where(known, depth, 1.0 / _pull_push(weight / safe, weight))


def _pull_push(total: Array, weight: Array) -> Array:
    """[H, W] total / weight; where the weight is 0, from the coarser levels."""
    height, width = weight.shape
    if (weight > 0).all():
        return total / weight
    pad = ((0, height % 2), (0, width % 2))
    coarse = _pull_push(*(_halved(np.pad(values, pad)) for values in (total, weight)))
    smooth = zoom(coarse, 2, order=1, mode="nearest", grid_mode=True)[:height, :width]
    return np.where(weight > 0, total / np.where(weight > 0, weight, 1.0), smooth)


def _halved(values: Array) -> Array:
    height, width = values.shape
    sums: Array = values.reshape(height // 2, 2, width // 2, 2).sum((1, 3))
    return sums
