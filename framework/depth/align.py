"""Aligns depth of unknown scale with the scene's sparse points.

Depth from other programs is often known only up to a factor. Inverse depth of a monocular network
is known up to a factor and a shift (Ranftl et al., TPAMI 2022, section 5). Both fits are robust.
The factor is a median of ratios. Factor and shift minimise the sum of absolute residuals, by
iteratively reweighted least squares (Schlossmacher, JASA 1973).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from framework.depth.transfer import inside, project
from framework.errors import require

if TYPE_CHECKING:
    from framework.types import TrainingSet

MIN_POINTS = {"scale": 8, "scale_shift": 16}
ITERATIONS = 100


def fit_scale(values: NDArray[np.float64], targets: NDArray[np.float64]) -> float:
    """The median of targets / values; both [M] and positive."""
    return float(np.median(targets / values))


def fit_scale_shift(
    values: NDArray[np.float64], targets: NDArray[np.float64]
) -> tuple[float, float]:
    """(s, b) that minimise sum |s values + b - targets| over [M] pairs."""
    floor = 1e-6 * float(np.abs(targets).max())  # keeps the weights of exact fits finite
    weights = np.ones_like(values)
    solution = np.zeros(2)
    for _ in range(ITERATIONS):
        update = _weighted_line(values, targets, weights)
        settled = np.allclose(update, solution, rtol=1e-9, atol=0.0)
        solution = update
        if settled:
            break
        residuals = np.maximum(np.abs(solution[0] * values + solution[1] - targets), floor)
        weights = floor / residuals
    return float(solution[0]), float(solution[1])


def _weighted_line(
    values: NDArray[np.float64], targets: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """[2] slope and offset of the least squares line through [M] points; a level one through equal
    values. Not by a library, whose rounding depends on the processor."""
    total = weights.sum()
    x, y = (float((weights * v).sum() / total) for v in (values, targets))
    spread = float((weights * np.square(values - x)).sum())
    slope = float((weights * (values - x) * (targets - y)).sum()) / spread if spread > 0 else 0.0
    return np.array([slope, y - slope * x])


def point_samples(
    training: TrainingSet, index: int, values: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """`values` [H, W] and depths ([M] each) at the sparse points that view `index` sees.

    Read at the pixel that contains the point; pixels without a value (0) are left out.
    """
    camera = training.views[index].camera
    seen = training.points.visible.numpy()[:, index]
    uvz = project(camera, training.points.xyz.numpy()[seen])
    uvz = uvz[inside(camera, uvz)]
    sampled = values[uvz[:, 1].astype(np.int64), uvz[:, 0].astype(np.int64)]
    valid = sampled > 0
    return sampled[valid], uvz[valid, 2]


def align(
    training: TrainingSet,
    index: int,
    values: NDArray[np.float64],
    inverse: bool,
    mode: str,
    where: str = "depth=file",
    way_out: str = "use depth.align=none with depth in scene units",
) -> NDArray[np.float64]:
    """Convert `values` of a view to depth in scene units.

    Args:
        training: views and sparse points.
        index: of the view.
        values: [H, W], 0 = unknown.
        inverse: the values are inverse depths, which are then fitted.
        mode: "none", "scale" or "scale_shift".
        where, way_out: for messages.

    Returns:
        Depth [H, W], 0 = unknown, also where the fit is at or behind infinity.

    Raises:
        UserError: too few sparse points are on known pixels, or larger values are farther (nearer,
            for inverse depth) than smaller ones.
    """
    scale, shift = 1.0, 0.0
    if mode != "none":
        name = training.views[index].name
        samples, depths = point_samples(training, index, values)
        require(
            len(samples) >= MIN_POINTS[mode],
            f"{where}: align={mode} needs {MIN_POINTS[mode]} sparse points on known depth in view"
            f" '{name}', got {len(samples)}; {way_out}",
        )
        targets = 1.0 / depths if inverse else depths
        if mode == "scale":
            scale = fit_scale(samples, targets)
        else:
            scale, shift = fit_scale_shift(samples, targets)
        require(
            scale > 0,
            f"{where}: expected values that grow with the {'inverse ' if inverse else ''}depth"
            f" of the sparse points in view '{name}', got a fitted factor of {scale:.3g}; set"
            f" depth.kind={'depth' if inverse else 'inverse_depth'} or check the files",
        )
    fitted = np.where(values > 0, scale * values + shift, 0.0)
    valid = fitted > 0
    safe = np.where(valid, fitted, 1.0)
    return np.where(valid, 1.0 / safe if inverse else safe, 0.0)
