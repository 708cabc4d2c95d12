"""Guesses a surface for pixels without consistent depth: far backgrounds, areas that one view sees.

Without a guess there is only the background colour, and no Gaussian is near to learn the photo. The
guess continues the depth around the pixel, including that of sparse points. It prefers the farther
depth at an edge, since what stereo misses is mostly behind. Then it moves back along its ray until
no training view looks through it and it is outside the ball around the cameras. Other cameras look
through that ball, so floaters in it would hide the scene.
"""

from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import zoom

from framework.compute.parallel import run_tasks
from framework.geometry import project
from framework.initialize.fusion import Mapped, SurfacePixels, joined, surface_pixels
from framework.initialize.sight import pushed_back

Array = NDArray[np.float64]

FAR_PREFERENCE = 2.0  # weight of a known pixel: its depth to this power
STEPS = np.geomspace(1.0, 8.0, 9)  # tried factors on a guessed depth, nearest first
BALL = 1.5  # radius of the cameras' ball, in scene extents
SAME_GUESS = 0.15  # relative depth difference up to which two views guess the same surface


def complete(maps: Mapped, tolerance: float) -> SurfacePixels:
    """The guessed pixels of all training views, from the most central view to the outermost one.

    A pixel stays out where another view has a consistent or an earlier one a guessed surface, or
    where some view looks through every place on its ray.
    """
    seen, views = maps.seen, range(len(maps.order))
    starts = run_tasks([partial(_start, maps, v) for v in views])
    ball = seen.centers.mean(0), BALL * maps.training.extent
    guesses, parts = np.zeros_like(seen.depth), []
    for v, start in zip(views, starts, strict=True):
        near = (guesses, SAME_GUESS)
        places, depth = pushed_back(seen, v, start, ball, STEPS, tolerance, near)
        seen.image(guesses, v)[:] = depth
        parts.append(surface_pixels(maps, v, places, depth, depth > 0))
    return joined(parts)


def _start(maps: Mapped, v: int) -> Array:
    """[H, W] depth from the surroundings where view `v` has none; 0 elsewhere."""
    depth, mask = maps.seen.image(maps.seen.depth, v), maps.views[v].mask
    around = filled(_with_points(maps, v))
    empty = depth == 0
    if mask is not None:
        empty &= mask.numpy() > 0.5
    return np.where(empty, around, 0.0)


def _with_points(maps: Mapped, v: int) -> Array:
    """[H, W] the consistent depth and, where it has none, that of the sparse points it sees."""
    depth: Array = maps.seen.image(maps.seen.depth, v).copy()
    points, camera = maps.training.points, maps.views[v].camera
    uv, z = project(points.xyz[points.visible[:, maps.order[v]]].to(torch.float64), camera)
    inside = (z > 0) & (uv >= 0).all(1)
    inside &= (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
    column, row = uv[inside].long().unbind(1)
    at = (row.numpy(), column.numpy())
    depth[at] = np.where(depth[at] > 0, depth[at], z[inside].numpy())
    return depth


def filled(depth: Array) -> Array:
    """[H, W] depth, its unknown pixels (0) filled from the known ones around them; all zeros stay.

    Pull-push (Gortler et al., SIGGRAPH 1996, section 3.4) of inverse depth, weighted by depth^2.
    """
    valid = depth > 0
    if valid.all() or not valid.any():
        return depth
    safe = np.where(valid, depth, 1.0)
    weight = np.where(valid, (safe / safe[valid].max()) ** FAR_PREFERENCE, 0.0)
    return np.where(valid, depth, 1.0 / _pull_push(weight / safe, weight))


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
