"""LDR-FLIP: the difference that an observer sees when flipping between two images.

Source: Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images", HPG. This
implementation is several times as fast as the authors' package, which tests compare it with.

A colour pipeline blurs both images by what the eye cannot resolve and measures the distance of
colours (0 to 1). A feature pipeline finds edges and points that only one of them has, which
magnify it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.compute import portable
from framework.compute.jit import kernel

PIXELS_PER_DEGREE = 0.7 * 3840 / 0.7 * math.pi / 180  # 4K, 0.7 m wide, at 0.7 m
COLOUR_POWER, COLOUR_KNEE, KNEE_ERROR = 0.7, 0.4, 0.95  # q_c, p_c, p_t
FEATURE_WIDTH = 0.082  # w in degrees

# contrast sensitivity: (a, b) of the Gaussians of each opponent channel
SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))

XYZ_OF_RGB = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)  # sRGB with white D65
WHITE = XYZ_OF_RGB.sum(1)
# linear RGB to Y_y C_x C_z without the offset of -16 in Y_y, which all filters below cancel
OPPONENT = portable.product(
    np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]]), XYZ_OF_RGB / WHITE[:, None]
)
UNOPPONENT = portable.inverse(OPPONENT)

Array = np.ndarray


def error_map(reference: Array, test: Array) -> Array:
    """FLIP [H, W] float32 in [0, 1] of two [H, W, 3] uint8 images in sRGB; symmetric."""
    decoded = [_linear(image) for image in (reference, test)]
    opponent = [_transformed(image, OPPONENT) for image in decoded]
    colour = _redistributed(_hyab(*(_lab(_blurred(image)) for image in opponent)))
    features = [_features(image[0] / np.float32(116)) for image in opponent]
    lost = np.maximum(*(abs(a - b) for a, b in zip(*features, strict=True)))  # edges, points
    strength = np.sqrt(lost / np.float32(math.sqrt(2)))  # to the power q_f = 1/2
    return _float32(portable.power(colour, 1 - strength))


def _linear(image: Array) -> Array:
    """Linear RGB [3, H, W] float32 of 8-bit sRGB [H, W, 3]."""
    encoded = np.arange(256) / 255
    low, high = encoded / 12.92, portable.power((encoded + 0.055) / 1.055, 2.4)
    return _float32(np.where(encoded <= 0.04045, low, high))[image.transpose(2, 0, 1)]


def _blurred(opponent: Array) -> Array:
    """Linear RGB in [0, 1] after a blur by the eye's contrast sensitivity."""
    widest = max(b for gaussians in SENSITIVITY for _, b in gaussians)
    radius = math.ceil(3 * math.sqrt(widest / (2 * math.pi**2)) * PIXELS_PER_DEGREE)
    degrees = np.arange(-radius, radius + 1) / PIXELS_PER_DEGREE
    blurred = np.zeros_like(opponent)
    for channel, gaussians in enumerate(SENSITIVITY):
        rows = [portable.exp(-np.square(math.pi * degrees) / b) for _, b in gaussians]
        weights = np.array([a * math.sqrt(math.pi / b) for a, b in gaussians])
        weights /= (weights * [row.sum() ** 2 for row in rows]).sum()
        for row, weight in zip(rows, weights, strict=True):
            blurred[channel] += _filtered(opponent[channel], row, weight * row)
    return np.clip(_transformed(blurred, UNOPPONENT), 0, 1)


def _lab(linear: Array) -> Array:
    """CIELAB with Hunt's adjustment: colours of dark pixels differ less."""
    relative = _transformed(linear, XYZ_OF_RGB / WHITE[:, None])
    delta = 6 / 29
    low = relative / np.float32(3 * delta**2) + np.float32(4 / 29)
    x, y, z = np.where(relative > delta**3, _float32(portable.power(relative, 1 / 3)), low)
    light = 116 * y - 16
    hunt = np.float32(0.01) * light
    return np.stack([light, 500 * (x - y) * hunt, 200 * (y - z) * hunt])


def _hyab(a: Array, b: Array) -> Array:
    """Distance of two colours: city-block in lightness, Euclidean in the rest."""
    light, red, blue = a - b
    return abs(light) + np.sqrt(red * red + blue * blue)


def _redistributed(distance: Array) -> Array:
    """Errors in [0, 1] from distances; large ones, which look alike, are compressed."""
    green, blue = (_lab(np.array(c, np.float32)[:, None]) for c in ((0, 1, 0), (0, 0, 1)))
    largest = float(portable.power(_hyab(green, blue)[0], COLOUR_POWER))
    knee = COLOUR_KNEE * largest
    error = _float32(portable.power(distance, COLOUR_POWER))
    low = error * np.float32(KNEE_ERROR / knee)
    high = KNEE_ERROR + (error - knee) * np.float32((1 - KNEE_ERROR) / (largest - knee))
    return np.where(error < knee, low, high)


def _features(grey: Array) -> tuple[Array, Array]:
    """Strength of edges and of points [H, W]: magnitudes of the first and second derivatives of a
    Gaussian, which is as wide as what the eye detects."""
    deviation = 0.5 * FEATURE_WIDTH * PIXELS_PER_DEGREE
    radius = math.ceil(3 * deviation)
    x = np.arange(-radius, radius + 1)
    smooth = portable.exp(-(x**2) / (2 * deviation**2))
    edge, point = _balanced(-x * smooth), _balanced((x**2 / deviation**2 - 1) * smooth)
    smooth /= smooth.sum()

    def magnitude(row: Array) -> Array:
        u, v = _filtered(grey, row, smooth), _filtered(grey, smooth, row)
        return np.sqrt(u * u + v * v)

    return magnitude(edge), magnitude(point)


def _balanced(weights: Array) -> Array:
    """Scale positive weights to sum to 1, negative ones to -1."""
    positive, negative = np.maximum(weights, 0), np.minimum(weights, 0)
    return positive / positive.sum() - negative / negative.sum()


def _filtered(image: Array, across: Array, down: Array) -> Array:
    """Correlation with a separable filter; edge padding."""
    reach = len(across) // 2
    padded = np.pad(image, ((0, 0), (reach, reach)), mode="edge")
    once, out = np.zeros_like(image), np.zeros_like(image)
    _correlate(padded, _float32(across), _float32(down), once, out)
    return out


@kernel
def _correlate(padded: Any, across: Any, down: Any, once: Any, out: Any) -> None:
    """Correlate along rows, then columns. Tap by tap, so that a pixel's sum has the same order on
    any processor."""
    height, width = out.shape
    reach = len(down) // 2
    for y in range(height):
        for k in range(len(across)):
            for x in range(width):
                once[y, x] += across[k] * padded[y, x + k]
    for y in range(height):
        for k in range(len(down)):
            row = min(max(y + k - reach, 0), height - 1)
            for x in range(width):
                out[y, x] += down[k] * once[row, x]


def _transformed(image: Array, matrix: Array) -> Array:
    """matrix @ image [3, ...] in float32, summed in the order of the channels."""
    rows = []
    for weights in _float32(matrix):
        a, b, c = (weight * channel for weight, channel in zip(weights, image, strict=True))
        rows.append(a + b + c)
    return np.stack(rows)


def _float32(values: Array) -> Array:
    return values.astype(np.float32)
