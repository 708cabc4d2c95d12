"""Compares points in space with the depth of all views, for every pixel of one view at a time.

View v *shows* a point if its depth, read at the pixel that contains the projection, is equal within
a tolerance. It *looks through* the point if the nearest depth of 3 x 3 pixels is clearly behind.
All is float64 with the operations of `framework.geometry` in the same order, for equal bits.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from scipy.ndimage import minimum_filter

from framework.compute import portable
from framework.compute.jit import kernel
from framework.compute.parallel import run_blocks, run_tasks
from framework.types import Camera, DepthMap, View

CENTER = 30  # where it begins in a row of `Sights.cameras`


class Sights(NamedTuple):
    """The confident depth of V views, all their pixels in one row.

    cameras [V, 33] float64: the three rows of [R | t], those of K, those of its inverse, the
    centre. frames [V, 3] int64: height, width, and where the view's pixels begin. depth, nearest
    [P] float64: 0 = none; the smallest depth of the 3 x 3 neighbours, infinite where none has any.
    """

    cameras: np.ndarray
    frames: np.ndarray
    depth: np.ndarray
    nearest: np.ndarray

    def image(self, values: np.ndarray, v: int) -> np.ndarray:
        """The part of `values` [P, ...] that is view v's, [H, W, ...]."""
        height, width, first = self.frames[v]
        return values[first : first + height * width].reshape(height, width, *values.shape[1:])

    @property
    def centers(self) -> np.ndarray:
        """[V, 3] of the cameras."""
        return self.cameras[:, CENTER:]


def sights(views: Sequence[View], maps: Sequence[DepthMap]) -> Sights:
    """Stack views and their depth maps. Masked and unconfident pixels have no depth."""
    sizes = [(view.camera.height, view.camera.width) for view in views]
    planes = run_tasks([partial(_confident, v, m) for v, m in zip(views, maps, strict=True)])
    pixels = np.array([height * width for height, width in sizes])
    return Sights(
        np.stack([_camera(view.camera) for view in views]),
        np.column_stack([np.array(sizes), np.cumsum(pixels) - pixels]).astype(np.int64),
        np.concatenate([depth.reshape(-1) for depth, _ in planes]),
        np.concatenate([nearest.reshape(-1) for _, nearest in planes]),
    )


def unrepeated(seen: Sights, v: int, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Which pixels of view v add a surface to those of the views before it: places [H, W, 3] and
    [H, W] bool. A pixel does if no view before shows its place, and at least as many others show
    it as look through it."""
    height, width = seen.frames[v, :2]
    places, chosen = np.empty((height, width, 3)), np.zeros((height, width), np.bool_)
    run_blocks(_unrepeated, *seen, v, tolerance, places, chosen)
    return places, chosen


def pushed_back(
    seen: Sights,
    v: int,
    start: np.ndarray,
    ball: tuple[np.ndarray, float],
    steps: np.ndarray,
    tolerance: float,
    guesses: tuple[np.ndarray, float],
) -> tuple[np.ndarray, np.ndarray]:
    """Push guessed depth of view v back until no view contradicts it.

    The depth is `start` times the smallest of `steps` with which the point is outside the `ball`
    (centre [3], radius) and no other view looks through it. There is no depth if no step fits, if
    another view shows the point, or if an earlier view guessed it.

    Args:
        start: [H, W] depth, 0 without a guess.
        guesses: the depths [P] of earlier views, and the distance that counts as equal.

    Returns:
        Points [H, W, 3] and their depth [H, W], 0 = none.
    """
    places, depth = np.empty((*start.shape, 3)), np.zeros(start.shape)
    run_blocks(_pushed_back, *seen, v, start, *ball, steps, tolerance, *guesses, places, depth)
    return places, depth


@kernel
def _pixel(cameras, frames, v, x, y, z):
    """(its index in the row of all pixels or -1, depth) of a place in view v."""
    c = x * cameras[v, 8] + y * cameras[v, 9] + z * cameras[v, 10] + cameras[v, 11]
    if not c > 0.0:
        return -1, c
    a = x * cameras[v, 0] + y * cameras[v, 1] + z * cameras[v, 2] + cameras[v, 3]
    b = x * cameras[v, 4] + y * cameras[v, 5] + z * cameras[v, 6] + cameras[v, 7]
    column = (a * cameras[v, 12] + b * cameras[v, 13] + c * cameras[v, 14]) / c
    row = (a * cameras[v, 15] + b * cameras[v, 16] + c * cameras[v, 17]) / c
    height, width = frames[v, 0], frames[v, 1]
    if row >= 0.0 and column >= 0.0 and row < height and column < width:
        return frames[v, 2] + np.int64(row) * width + np.int64(column), c
    return -1, c


@kernel
def _ray(cameras, v, row, column):
    """Through the centre of a pixel, in the camera's axes, z = 1."""
    x, y = column + 0.5, row + 0.5
    return (
        x * cameras[v, 21] + y * cameras[v, 22] + cameras[v, 23],
        x * cameras[v, 24] + y * cameras[v, 25] + cameras[v, 26],
        x * cameras[v, 27] + y * cameras[v, 28] + cameras[v, 29],
    )


@kernel
def _place(cameras, v, ray, z):
    """The place at depth z on a ray of view v."""
    a, b, c = ray[0] * z, ray[1] * z, ray[2] * z
    return (
        a * cameras[v, 0] + b * cameras[v, 4] + c * cameras[v, 8] + cameras[v, 30],
        a * cameras[v, 1] + b * cameras[v, 5] + c * cameras[v, 9] + cameras[v, 31],
        a * cameras[v, 2] + b * cameras[v, 6] + c * cameras[v, 10] + cameras[v, 32],
    )


@kernel
def _shows(depth, z, tolerance):
    return depth > 0.0 and abs(z - depth) < tolerance * depth


@kernel
def _looks_through(nearest, z, tolerance):
    return nearest < np.inf and z < (1.0 - tolerance) * nearest


@kernel
def _unrepeated(block, blocks, cameras, frames, depth, nearest, v, tolerance, places, chosen):
    height, width = chosen.shape
    for row in range(height * block // blocks, height * (block + 1) // blocks):
        for column in range(width):
            z_pixel = depth[frames[v, 2] + row * width + column]
            if not z_pixel > 0.0:
                continue
            x, y, z = _place(cameras, v, _ray(cameras, v, row, column), z_pixel)
            votes, repeated = 0, False
            for other in range(len(frames)):
                if other == v:
                    continue
                at, far = _pixel(cameras, frames, other, x, y, z)
                if at >= 0:
                    shows = _shows(depth[at], far, tolerance)
                    votes += int(shows) - int(_looks_through(nearest[at], far, tolerance))
                    repeated = repeated or (shows and other < v)
            chosen[row, column] = votes >= 0 and not repeated
            places[row, column, 0] = x
            places[row, column, 1] = y
            places[row, column, 2] = z


@kernel
def _pushed_back(
    block,
    blocks,
    cameras,
    frames,
    depth,
    nearest,
    v,
    start,
    center,
    radius,
    steps,
    tolerance,
    guesses,
    same,
    places,
    guessed,
):
    height, width = start.shape
    for row in range(height * block // blocks, height * (block + 1) // blocks):
        for column in range(width):
            if not start[row, column] > 0.0:
                continue
            ray = _ray(cameras, v, row, column)
            for step in steps:
                z_pixel = step * start[row, column]
                x, y, z = _place(cameras, v, ray, z_pixel)
                dx, dy, dz = x - center[0], y - center[1], z - center[2]
                free, taken = np.sqrt(dx * dx + dy * dy + dz * dz) >= radius, False
                for other in range(len(frames)):
                    if other == v or not free:
                        continue
                    at, far = _pixel(cameras, frames, other, x, y, z)
                    if at >= 0:
                        free = not _looks_through(nearest[at], far, tolerance)
                        taken = taken or _shows(depth[at], far, tolerance)
                        taken = taken or (other < v and _shows(guesses[at], far, same))
                if free:
                    if not taken:
                        guessed[row, column] = z_pixel
                        places[row, column, 0] = x
                        places[row, column, 1] = y
                        places[row, column, 2] = z
                    break


def _confident(view: View, estimate: DepthMap) -> tuple[np.ndarray, np.ndarray]:
    """The depth that may be used, and the nearest around each pixel; see `Sights`."""
    valid = (estimate.confidence > 0) & (estimate.depth > 0) & torch.isfinite(estimate.depth)
    if view.mask is not None:
        valid &= view.mask > 0.5
    depth = torch.where(valid, estimate.depth, 0).to(torch.float64).numpy()
    near = np.where(valid.numpy(), depth, np.inf)
    return depth, minimum_filter(near, 3, mode="nearest")


def _camera(camera: Camera) -> np.ndarray:
    """A row of `Sights.cameras`."""
    parts = (
        camera.viewmat[:3],
        camera.K,
        torch.from_numpy(portable.inverse(camera.K.numpy())),
        camera.center,
    )
    return np.concatenate([part.numpy().reshape(-1) for part in parts])
