"""Kernels of LPIPS on feature maps [H, W, C], float32, contiguous, with C a multiple of 16."""

import math
from typing import Any

import numpy as np

from framework.compute.jit import kernel
from framework.compute.simd import LANES, fma, lane_sums, load, store, zeros

_EPS = np.float32(1e-10)  # keeps the division finite where no feature responds
_ONE = np.float32(1)


@kernel
def difference(x: Any, y: Any, weight: Any) -> Any:
    """Sum over pixels and channels of weight_c (x_c / |x| - y_c / |y|)^2, with the norm over the
    channels of a pixel. x, y: [H, W, C]; weight: [C]."""
    n_channels, flat_x, flat_y = x.shape[2], x.reshape(-1), y.reshape(-1)
    sums = np.empty(LANES, np.float32)
    total = 0.0
    for pixel in range(0, flat_x.size, n_channels):
        squares_x, squares_y, squares = zeros(), zeros(), zeros()
        for c in range(0, n_channels, LANES):
            value_x, value_y = load(flat_x, pixel + c), load(flat_y, pixel + c)
            squares_x = fma(value_x, value_x, squares_x)
            squares_y = fma(value_y, value_y, squares_y)
        store(sums, 0, lane_sums((squares_x, squares_y)))
        scale_x, scale_y = _ONE / (math.sqrt(sums[0]) + _EPS), _ONE / (math.sqrt(sums[1]) + _EPS)
        for c in range(0, n_channels, LANES):
            distance = load(flat_x, pixel + c) * scale_x - load(flat_y, pixel + c) * scale_y
            squares = fma(distance * distance, load(weight, c), squares)
        store(sums, 0, lane_sums((squares,)))
        total += sums[0]
    return total
