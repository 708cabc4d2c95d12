"""Plane sweep over all training views: match, aggregate, select, check.

The planes of a view are fronto-parallel to it and evenly spaced in inverse depth q between its
depth bounds (Collins, CVPR 1996; Gallup et al., CVPR 2007). Matching works with q x farthest
depth, so that its numbers do not depend on the unit of length.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from framework.compute.parallel import run_blocks
from framework.depth.consistency import agreeing_views, depth_map
from framework.depth.matching.aggregate import aggregate_columns, aggregate_rows, select_planes
from framework.depth.matching.match import COST_ONE, VARIANCE_FLOOR, match_costs
from framework.depth.matching.neighbours import choose_neighbours, depth_bounds, grid_points
from framework.depth.options import PlaneSweepOptions
from framework.depth.transfer import inside, pixel_transfer, project
from framework.errors import require
from framework.types import DepthMap, TrainingSet, View

Array = NDArray[np.float64]
LUMA = np.array([0.299, 0.587, 0.114], np.float32)  # ITU-R BT.601
FEWEST_PLANES, MOST_PLANES = 96, 256  # of views whose number of planes is not given
MOST_CELLS = 2**29  # pixels x planes, two volumes of 1 GiB; over 5.6 megapixels take more
MIN_ZNCC = 0.05  # floor of the score in a confidence, so that a consistent pixel never gets zero


def grey(view: View) -> NDArray[np.float32]:
    """[H, W] float32 luma, its mean removed, which keeps float32 window sums accurate."""
    red, green, blue = LUMA[:, None, None] * view.image.numpy()
    luma = red + green + blue
    centred: NDArray[np.float32] = np.ascontiguousarray(luma - luma.mean(), np.float32)
    return centred


def window_statistics(
    image: NDArray[np.float32], radius: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean and 1 / deviation [H, W] of the windows of an image, its border repeated."""
    values = image.astype(np.float64)
    mean = uniform_filter(values, 2 * radius + 1, mode="nearest")
    square = uniform_filter(values**2, 2 * radius + 1, mode="nearest")
    variance = np.maximum(square - mean**2, 0.0)
    inverse = 1.0 / np.sqrt(variance + VARIANCE_FLOOR)
    return mean.astype(np.float32), inverse.astype(np.float32)


def zncc(a: Array, b: Array, radius: int) -> Array:
    """[H, W] zero-mean normalised cross-correlation of the windows of two images, borders repeated,
    with `VARIANCE_FLOOR` added to both variances."""

    def mean(values: Array) -> Array:
        result: Array = uniform_filter(values, 2 * radius + 1, mode="nearest")
        return result

    mean_a, mean_b = mean(a), mean(b)
    variance_a = np.maximum(mean(a * a) - mean_a**2, 0) + VARIANCE_FLOOR
    variance_b = np.maximum(mean(b * b) - mean_b**2, 0) + VARIANCE_FLOOR
    return (mean(a * b) - mean_a * mean_b) / np.sqrt(variance_a * variance_b)


def cost_volume(
    views: Sequence[View],
    images: Sequence[NDArray[np.float32]],
    index: int,
    sources: Sequence[int],
    bounds: tuple[float, float],
    planes: int,
    radius: int,
) -> NDArray[np.int16]:
    """[H, D, W] matching costs of view `index` at D `planes`.

    A cost is the mean over the best half of the sources, rounded down (at least one). This leaves
    out sources in which the surface is hidden.
    """
    near, far = bounds
    height, width = images[index].shape
    transfers = [pixel_transfer(views[index].camera, views[s].camera) for s in sources]
    A = np.stack([a for a, _ in transfers]).astype(np.float32)
    t = np.stack([b / far for _, b in transfers]).astype(np.float32)
    sizes = np.array([images[s].shape for s in sources], np.int64)
    offsets = np.concatenate([[0], np.cumsum(sizes.prod(1))[:-1]])
    shapes = np.ascontiguousarray(np.column_stack([offsets, sizes]), np.int64)
    pixels = np.concatenate([images[s].ravel() for s in sources])
    padded = np.pad(images[index], ((0, 0), (radius, radius)), mode="edge")
    mean, inverse = window_statistics(images[index], radius)
    scaled = np.linspace(1.0, far / near, planes).astype(np.float32)
    cost = np.empty((height, planes, width), np.int16)
    run_blocks(
        match_costs, padded, mean, inverse, pixels, shapes, A, t, scaled,
        radius, max(1, len(sources) // 2), cost,
    )  # fmt: skip
    return cost


def edge_penalties(
    image: NDArray[np.float32], axis: int, options: PlaneSweepOptions
) -> NDArray[np.int16]:
    """[H, W] P2 between each pixel and the one before it along `axis`, in cost units."""
    first = np.take(image, [0], axis)
    step = np.abs(np.diff(image, axis=axis, prepend=first))
    penalty = options.penalty_large / (1.0 + options.edge * step)
    return np.rint(COST_ONE * np.maximum(penalty, options.penalty_small)).astype(np.int16)


def plane_spacing(
    views: Sequence[View], index: int, sources: Sequence[int], bounds: tuple[float, float], n: int
) -> float:
    """Shift of a match between neighbouring planes, in pixels of the sources; median over a grid in
    the image and over the sources."""
    near, far = bounds
    steps, camera = [], views[index].camera
    middle = 0.5 * (1 / near + 1 / far)
    pair = [1 / (middle + side * (1 / near - 1 / far) / (n - 1)) for side in (-0.5, 0.5)]
    for source in (views[s].camera for s in sources):
        a, b = (project(source, grid_points(camera, z, z)) for z in pair)
        seen = inside(source, a) & inside(source, b)
        steps.append(np.linalg.norm(a[seen, :2] - b[seen, :2], axis=1))
    moved = np.concatenate(steps)
    return float(np.median(moved)) if len(moved) else 1.0


def plane_count(spacing: float, pixels: int) -> int:
    """Planes at which a match moves by a pixel, within limits.

    Between planes further apart, the windows of a textured surface no longer match at either. Fewer
    than 96 planes lose surfaces even where they lie closer; more than 256 find little more.

    Args:
        spacing: how far a match moves between `FEWEST_PLANES` planes, in pixels.
        pixels: of the view.
    """
    needed = math.ceil((FEWEST_PLANES - 1) * spacing) + 1
    return max(min(needed, MOST_PLANES, MOST_CELLS // pixels), FEWEST_PLANES)


def aggregate(
    cost: NDArray[np.int16], image: NDArray[np.float32], spacing: float, options: PlaneSweepOptions
) -> NDArray[np.int16]:
    """[H, D, W] costs summed over the four paths.

    P1 shrinks with the `spacing` of the planes below one pixel; else finely spaced planes would
    make every slant expensive and flatten it.
    """
    total = np.empty_like(cost)
    small = np.int16(round(COST_ONE * options.penalty_small * min(1.0, spacing)))
    run_blocks(aggregate_rows, cost, edge_penalties(image, 1, options), small, total)
    run_blocks(aggregate_columns, cost, edge_penalties(image, 0, options), small, total)
    return total


def sweep_view(
    training: TrainingSet,
    images: Sequence[NDArray[np.float32]],
    index: int,
    sources: Sequence[int],
    bounds: tuple[float, float],
    options: PlaneSweepOptions,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth and ZNCC [H, W] of one view, unchecked; zeros if it has no sources."""
    shape = images[index].shape
    position, zncc = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    if not sources:
        return position, zncc
    planes = options.planes or FEWEST_PLANES
    spacing = plane_spacing(training.views, index, sources, bounds, planes)
    if not options.planes:
        planes = plane_count(spacing, images[index].size)
        spacing *= (FEWEST_PLANES - 1) / (planes - 1)
    cost = cost_volume(training.views, images, index, sources, bounds, planes, options.radius)
    total = aggregate(cost, images[index], spacing, options)
    run_blocks(select_planes, total, cost, position, zncc)
    near, far = bounds
    step = (far / near - 1.0) / (planes - 1)
    return (far / (1.0 + position.astype(np.float64) * step)).astype(np.float32), zncc


def confidence(
    zncc: NDArray[np.float32], agreeing: NDArray[np.int32], checked: int
) -> NDArray[np.float32]:
    """[H, W] in [0, 1]: max(ZNCC, 0.05) (1 - 2^-n) / (1 - 2^-N) for n of N views that agree."""
    share = (1.0 - np.ldexp(1.0, -agreeing)) / (1.0 - 0.5 ** max(checked, 1))
    return (np.clip(zncc, MIN_ZNCC, 1.0) * share).astype(np.float32)


def checked(
    training: TrainingSet, options: PlaneSweepOptions, limit: int
) -> list[tuple[tuple[float, float], list[int]]]:
    """The depth bounds and up to `limit` partners of every view.

    Raises:
        UserError: for views that are too few, too small, or do not overlap.
    """
    where, n, size = "depth=plane_sweep: expected", len(training.views), 2 * options.radius + 1
    require(
        n >= 2,
        f"{where} two or more overlapping training views, got {n} in scene '{training.scene}'; use"
        " more views, depth=file or depth=ground_truth",
    )
    least = min(min(view.camera.width, view.camera.height) for view in training.views)
    require(
        least >= size,
        f"{where} images of at least {size}x{size} pixels (the window), got one of {least} pixels"
        " on a side; lower depth.radius",
    )
    bounds = [depth_bounds(training, i) for i in range(n)]
    partners = [choose_neighbours(training, i, limit, bounds[i]) for i in range(n)]
    require(
        any(partners),
        f"{where} training views that overlap, got {n} views of scene '{training.scene}' without"
        f" any overlap between depths {training.near:g} and {training.far:g}; check scene.near and"
        " scene.far, use closer views from different places, or set depth=file",
    )
    return list(zip(bounds, partners, strict=True))


def sweep_views(training: TrainingSet, options: PlaneSweepOptions) -> tuple[DepthMap, ...]:
    """See `framework.depth.providers.PlaneSweep.measure`."""
    indices = range(len(training.views))
    bounds, sources = zip(*checked(training, options, options.neighbours), strict=True)
    images = [grey(view) for view in training.views]
    swept = [sweep_view(training, images, i, sources[i], bounds[i], options) for i in indices]
    depths = [depth for depth, _ in swept]
    cameras = [view.camera for view in training.views]
    maps = []
    for i, (depth, zncc) in enumerate(swept):
        agreeing = agreeing_views(depths, cameras, i, sources[i], options.tolerance)
        score = confidence(zncc, agreeing, len(sources[i]))
        maps.append(depth_map(training.views[i], depth, score))
    return tuple(maps)
