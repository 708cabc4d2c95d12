"""Screen-space second moments -> Fisher information of the stored parameters.

With d = (u, v, A, B, C, logit) the numbers through which a Gaussian's alpha depends on a pixel,
d(alpha)/d(d) = alpha L m, m = (1, dx, dy, dx^2, dx dy, dy^2). Hence, summed over pixels and
channels, sum (dC/dd)(dC/dd)^T = L Q L^T with Q = sum q m m^T (`tiles.blend_moments`), and one
pull-back by K = dd/d(parameters) gives F = K^T L Q L^T K exactly: every pixel's outer product is in
Q. Exact for view-independent colour; the mean's effect through the SH direction is left out.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from framework.jit import kernel
from framework.rasterize.projection import (
    Y0,
    pull_back,
    rotation,
    screen_axes,
    times_rotation,
    to_camera,
    unit_quat,
)
from framework.rasterize.simd import load, store, zeros

f4 = np.float32
ZERO, ONE, HALF = f4(0), f4(1), f4(0.5)
# which of the 15 sums holds m_i m_j
_PLACE = np.array(
    [
        [0, 1, 2, 3, 4, 5],
        [1, 3, 4, 6, 7, 8],
        [2, 4, 5, 7, 8, 9],
        [3, 6, 7, 10, 11, 12],
        [4, 7, 8, 11, 12, 13],
        [5, 8, 9, 12, 13, 14],
    ],
    dtype=np.int64,
)


@kernel
def _screen_jacobian(
    mean: Any, quat: Any, log_scale: Any, camera: Any, row: Any, unit: Any, jacobian: Any
) -> None:
    """jacobian[:10] [10, 6] = (L^T K)^T: d(alpha)/d(mean 3, log-scale 3, quat 4) / alpha in m.
    unit [10] is scratch."""
    x, y, z = to_camera(camera, mean)
    t = screen_axes(camera, x, y, z)
    q = unit_quat(quat)
    r = rotation(q[0], q[1], q[2], q[3])
    m = times_rotation(t, r)
    s = (math.exp(log_scale[0]), math.exp(log_scale[1]), math.exp(log_scale[2]))
    ca, cb, cc = row[13], row[14], row[15]
    jacobian[:10, :] = ZERO
    for p in range(3):  # u and v move with the mean alone, by T
        jacobian[p, 1] = ca * t[p] + cb * t[3 + p]
        jacobian[p, 2] = cb * t[p] + cc * t[3 + p]
    for k in range(3):
        ga, gb, gc = ONE if k == 0 else ZERO, ONE if k == 1 else ZERO, ONE if k == 2 else ZERO
        g = pull_back(camera, x, y, z, t, r, m, s, q, (ca, cb, cc), ZERO, ZERO, ga, gb, gc, ZERO)
        unit[0], unit[1], unit[2], unit[3], unit[4] = g[0], g[1], g[2], g[3], g[4]
        unit[5], unit[6], unit[7], unit[8], unit[9] = g[5], g[6], g[7], g[8], g[9]
        scale = -ONE if k == 1 else -HALF
        for p in range(10):
            jacobian[p, 3 + k] = scale * unit[p]


@kernel
def pull_back_moments(
    block: int,
    blocks: int,
    means: Any,
    quats: Any,
    log_scales: Any,
    logits: Any,
    camera: Any,
    rows: Any,
    clipped: Any,
    first: Any,
    slots: Any,
    fisher: Any,
    diagonal: Any,
) -> None:
    """Fisher block [N, 6, 6] in (mean, log-scale); diagonal [N, 14] in (mean 3, log-scale 3,
    quat 4, opacity logit, sh0 3). Zeros where the camera sees nothing of the Gaussian."""
    n = len(means)
    moments = np.empty(16, np.float32)
    jacobian = np.empty((11, 6), np.float32)
    image = np.empty((11, 6), np.float32)
    q = np.empty((6, 6), np.float32)
    unit = np.empty(10, np.float32)
    for i in range(n * block // blocks, n * (block + 1) // blocks):
        if first[i] == first[i + 1]:
            fisher[i, :, :] = ZERO
            diagonal[i, :] = ZERO
            continue
        sums = zeros()
        for j in range(first[i], first[i + 1]):
            sums = sums + load(slots, j * 16)
        store(moments, 0, sums)
        _screen_jacobian(means[i], quats[i], log_scales[i], camera, rows[i], unit, jacobian)
        jacobian[10, :] = ZERO
        jacobian[10, 0] = ONE / (ONE + math.exp(logits[i]))
        for a in range(6):
            for b in range(6):
                q[a, b] = moments[_PLACE[a, b]]
        for p in range(11):
            for a in range(6):
                value = ZERO
                for b in range(6):
                    value += q[a, b] * jacobian[p, b]
                image[p, a] = value
        for p in range(11):
            value = ZERO
            for a in range(6):
                value += jacobian[p, a] * image[p, a]
            diagonal[i, p] = value
        for p in range(6):
            for o in range(p, 6):
                value = ZERO
                for a in range(6):
                    value += jacobian[p, a] * image[o, a]
                fisher[i, p, o] = value
                fisher[i, o, p] = value
        for channel in range(3):
            seen = ZERO if (clipped[i] >> channel) & 1 else Y0 * Y0 * moments[15]
            diagonal[i, 11 + channel] = seen
