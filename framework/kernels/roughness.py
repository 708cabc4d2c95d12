"""Gradient of a penalty on rough disparity where the photo is smooth.

R = sum over pixels p and their right and lower neighbours q of w_pq |d_p - d_q|, with the inverse
expected depth d = alpha / depth. Pairs with an empty pixel do not count. The weights w are from
`framework.train.depth_priors`.

Source: Godard et al. 2017, equation 3.
"""

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.parallel import run_blocks
from framework.kernels.lending import ThreadsLender

SEEN = np.float32(1e-6)  # alpha from which a pixel shows something
_NONE, _ZERO = np.float32(-1), np.float32(0)


@inlined
def _step(disparity, other, weight):
    """w times the slope of |disparity - other|; a negative disparity means that nothing is seen."""
    slope = weight if disparity > other else (-weight if disparity < other else _ZERO)
    return slope if (disparity >= _ZERO) & (other >= _ZERO) else _ZERO


@kernel
def roughness_rows(block, blocks, alpha, depth, weights, in_alpha, in_depth):
    """A range of rows of the gradients in alpha and depth [H, W].

    Args:
        weights: [2, H, W], towards the right neighbour and the lower one. Row by row without
            branches, for vectors.
    """
    height, width = alpha.shape
    y0, y1 = height * block // blocks, height * (block + 1) // blocks
    above, below = max(0, y0 - 1), min(height, y1 + 1)
    disparity = np.empty((below - above, width), np.float32)
    for y in range(above, below):
        a, z, d = alpha[y], depth[y], disparity[y - above]
        for x in range(width):
            d[x] = a[x] / z[x] if (a[x] > SEEN) & (z[x] > _ZERO) else _NONE
    right = np.zeros(width + 1, np.float32)
    down = np.zeros((2, width), np.float32)  # from the row above to this, from this to the next
    if y0 > 0:
        for x in range(width):
            down[1, x] = _step(disparity[0, x], disparity[1, x], weights[1, y0 - 1, x])
    for y in range(y0, y1):
        d, z, w = disparity[y - above], depth[y], weights[0, y]
        for x in range(width - 1):
            right[x + 1] = _step(d[x], d[x + 1], w[x])
        for x in range(width):
            down[0, x] = down[1, x]
        if y + 1 < height:
            lower, w = disparity[y + 1 - above], weights[1, y]
            for x in range(width):
                down[1, x] = _step(d[x], lower[x], w[x])
        else:
            down[1] = _ZERO
        to_alpha, to_depth = in_alpha[y], in_depth[y]
        for x in range(width):
            pull = (right[x + 1] - right[x]) + (down[1, x] - down[0, x])
            pull = pull / z[x] if d[x] >= _ZERO else _ZERO
            to_alpha[x], to_depth[x] = pull, -pull * d[x]


_lender = ThreadsLender()


def roughness_gradient(
    alpha: np.ndarray, depth: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute the gradients of R in alpha and depth [H, W] float32, as `rasterize` returns them.

    Args:
        weights: [2, H, W] float32.

    Returns:
        Both gradients, in a buffer that is reused once unreferenced.
    """
    in_alpha, in_depth = _lender.lend([alpha.shape, alpha.shape])
    run_blocks(roughness_rows, alpha, depth, weights, in_alpha, in_depth)
    return in_alpha, in_depth
