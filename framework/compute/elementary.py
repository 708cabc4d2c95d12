"""Functions of sums, products, quotients and square roots alone, so their bits are the same on
every processor (see `portable`). Light to import.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def arctan(x: ArrayLike) -> Array:
    """The angle in radians, float64 of the shape of x. Three halvings, then the series."""
    values = np.array(x, np.float64)
    with np.errstate(divide="ignore"):
        rest = np.where(np.abs(values) > 1, 1 / values, values)
    for _ in range(3):
        rest = rest / (1 + np.sqrt(1 + rest * rest))
    square, series = rest * rest, np.zeros_like(rest)
    for k in range(14, -1, -1):
        series = series * -square + 1 / (2 * k + 1)
    angle = 8 * rest * series
    return np.where(np.abs(values) > 1, np.copysign(np.pi / 2, values) - angle, angle)


def sinc_cosine(square: Any) -> Any:
    """(sin x / x, cos x) of x whose square is given, up to a few turns: a number, or a tensor whose
    gradient is wanted. Three halvings of x, then the series."""
    a = square / 64
    sinc = cosine = 1.0
    for k in range(9, 0, -1):
        sinc = 1 - sinc * a / (2 * k * (2 * k + 1))
        cosine = 1 - cosine * a / (2 * k * (2 * k - 1))
    for _ in range(3):
        sinc, cosine = sinc * cosine, 1 - 2 * a * sinc * sinc
        a = 4 * a
    return sinc, cosine


def product(a: ArrayLike, b: ArrayLike) -> Array:
    """a @ b of small float64 matrices [..., n, m] and [..., m, k], or of a vector b [m], summed in
    the order of m."""
    x, y = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if y.ndim == 1:
        return product(x, y[:, None])[..., 0]
    total = x[..., :, :1] * y[..., :1, :]
    for k in range(1, x.shape[-1]):
        total = total + x[..., :, k : k + 1] * y[..., k : k + 1, :]
    return total


def inverse(matrix: ArrayLike) -> Array:
    """[3, 3] float64 inverse by cofactors; of [4, 4] with a last row (0, 0, 0, 1), too."""
    m = np.asarray(matrix, np.float64)
    if m.shape == (4, 4):
        out = np.eye(4)
        out[:3, :3] = inverse(m[:3, :3])
        out[:3, 3] = -product(out[:3, :3], m[:3, 3])
        return out
    (a, b, c), (d, e, f), (g, h, i) = m
    first = (e * i - f * h, f * g - d * i, d * h - e * g)
    determinant = a * first[0] + b * first[1] + c * first[2]
    rows = [
        [first[0], c * h - b * i, b * f - c * e],
        [first[1], a * i - c * g, c * d - a * f],
        [first[2], b * g - a * h, a * e - b * d],
    ]
    return np.array(rows) / determinant
