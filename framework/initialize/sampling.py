"""Which pixels become Gaussians: densities, inclusion probabilities and the draw.

Unequal-probability sampling without replacement and of fixed size: systematic sampling on a
randomly ordered list (Madow 1949) includes pixel i with exactly its probability p_i.
"""

import numpy as np
from scipy.ndimage import uniform_filter

from framework.compute import portable

FLOOR = 0.15  # density of a pixel without any detail, in units of the image's mean


def detail_density(image: np.ndarray, detail: float) -> np.ndarray:
    """[H, W] float64 relative sampling density (g / mean g)^detail + 0.15.

    Args:
        image: [3, H, W]. g: gradient magnitude of the grey image, smoothed by two 5 x 5 box
            filters. An image without any gradient gets a uniform density.
    """
    grey = image.astype(np.float64).mean(0)
    dy, dx = (_central_difference(grey, axis) for axis in (0, 1))
    gradient = np.sqrt(dx * dx + dy * dy)
    for _ in range(2):
        gradient = uniform_filter(gradient, 5, mode="nearest")
    mean = gradient.mean()
    if mean <= 0:
        return np.ones_like(gradient)
    return portable.power(np.maximum(gradient / mean, 0), detail) + FLOOR


def inclusion_probabilities(density: np.ndarray, budget: int) -> np.ndarray:
    """[P] float64 in (0, 1], proportional to `density` [P] > 0 where below 1, summing to `budget`
    (to P when there are no more than `budget` pixels)."""
    if budget >= len(density):
        return np.ones(len(density))
    probability = np.minimum(density * (budget / density.sum()), 1)
    while True:
        certain = probability >= 1
        missing = budget - certain.sum() - probability[~certain].sum()
        if missing <= 1e-9 * budget:
            return probability
        free = density[~certain]
        share = (budget - certain.sum()) / free.sum()
        probability[~certain] = np.minimum(free * share, 1)


def draw(probability: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Ascending indices [n] int64 of a sample, n the sum of `probability` [P] up to rounding."""
    order = rng.permutation(len(probability))
    steps = np.cumsum(probability[order])
    # the sum is a whole number but for rounding, which must not decide over one more sample
    steps *= np.rint(steps[-1]) / steps[-1]
    crossed = np.floor(np.append(0.0, steps) + rng.random())
    return np.sort(order[np.diff(crossed) > 0])


def _central_difference(values: np.ndarray, axis: int) -> np.ndarray:
    """The gradient along `axis`; 0 along an axis of a single pixel."""
    if values.shape[axis] < 2:
        return np.zeros_like(values)
    return np.gradient(values, axis=axis)
