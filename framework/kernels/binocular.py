"""Gradients of a consistency loss between a photo and a render from a shifted camera.

Binocular-Guided 3DGS (Han et al. 2024, arXiv 2410.18822, section 3.1): the camera moves by t along
its x axis, so a pixel at depth D moves along its row by -f t / D. The loss is the mean over pixels
and channels of |warped - photo|. Here, unlike in the paper, a pixel counts only where its depth
agrees with that of the shifted render. Elsewhere one surface hides the other, or one of the two
depths is wrong.
"""

from collections.abc import Sequence

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.parallel import run_blocks
from framework.kernels.constants import WHOLE
from framework.kernels.lending import ThreadsLender
from framework.kernels.roughness import SEEN

_NONE, _ZERO, _ONE, _WHOLE = (np.float32(x) for x in (-1, 0, 1, WHOLE))


@inlined
def _disparities(alpha, depth, into):
    """Inverse expected depth of a row; -1 where nothing is seen."""
    for x in range(len(into)):
        into[x] = alpha[x] / depth[x] if (alpha[x] > SEEN) & (depth[x] > _ZERO) else _NONE


@inlined
def _places(disparity, shifted, mask, numbers, left, share):
    """Fill, for every pixel of a row, the pixel to its left in the shifted render, the fraction
    to the next one, and into `disparity` its weight (0 if it does not count).
    """
    moves, tolerance, weight = numbers
    width = len(disparity)
    last, most = np.float32(width - 1), np.float32(max(width - 2, 0))
    to_right = np.uint32(width > 1)
    for x in range(width):
        there = np.float32(x) - moves * disparity[x]
        counts = (disparity[x] > _ZERO) & (mask[x] > _WHOLE) & (there >= _ZERO) & (there <= last)
        at = np.uint32(min(there, most)) if counts else np.uint32(0)
        rest = there - np.float32(at) if counts else _ZERO
        near, far = shifted[at], shifted[at + to_right]
        apart = abs((near + rest * (far - near)) - disparity[x])
        counts = counts & (near > _ZERO) & (far > _ZERO) & (apart < tolerance)
        left[x], share[x] = at, rest
        disparity[x] = weight if counts else _ZERO


@inlined
def _pull(rgb, photo, weights, left, share, in_rgb, slope):
    """One colour of a row: the gradient in what is seen from beside, and added to `slope` how the
    loss moves with the place where a pixel is seen."""
    to_right = np.uint32(len(weights) > 1)
    for x in range(len(weights)):
        at, rest = left[x], share[x]
        near, far = rgb[at], rgb[at + to_right]
        error = near + rest * (far - near) - photo[x]
        pull = weights[x] if error > _ZERO else (-weights[x] if error < _ZERO else _ZERO)
        in_rgb[at] += pull * (_ONE - rest)
        in_rgb[at + to_right] += pull * rest
        slope[x] += pull * (far - near)


@kernel
def binocular_rows(
    block,
    blocks,
    alpha,
    depth,
    rgb_beside,
    alpha_beside,
    depth_beside,
    photo,
    mask,
    moves,
    tolerance,
    weight,
    in_alpha,
    in_depth,
    in_rgb,
):
    """Compute a range of rows of the gradients; the arguments are those of `binocular_gradient`."""
    height, width = alpha.shape
    disparity, disparity_beside = np.empty(width, np.float32), np.empty(width, np.float32)
    share, slope = np.empty(width, np.float32), np.empty(width, np.float32)
    left = np.empty(width, np.uint32)
    for y in range(height * block // blocks, height * (block + 1) // blocks):
        _disparities(alpha[y], depth[y], disparity)
        _disparities(alpha_beside[y], depth_beside[y], disparity_beside)
        _places(disparity, disparity_beside, mask[y], (moves, tolerance, weight), left, share)
        slope[:] = _ZERO
        for c in range(3):
            in_rgb[c, y] = _ZERO
            _pull(rgb_beside[c, y], photo[c, y], disparity, left, share, in_rgb[c, y], slope)
        to_alpha, to_depth, a, z = in_alpha[y], in_depth[y], alpha[y], depth[y]
        for x in range(width):
            counts = disparity[x] > _ZERO
            pull = moves * slope[x] / z[x] if counts else _ZERO
            to_alpha[x] = -pull
            to_depth[x] = pull * (a[x] / z[x]) if counts else _ZERO


_lender = ThreadsLender()


def binocular_gradient(
    alpha: np.ndarray,
    depth: np.ndarray,
    beside: Sequence[np.ndarray],
    photo: np.ndarray,
    mask: np.ndarray,
    moves: float,
    tolerance: float,
    weight: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the gradients of the consistency loss.

    Args:
        beside: colours, alpha and depth of the shifted render.
        photo: [3, H, W], multiplied by its mask [H, W].
        moves: f t, the shift in pixels of a point at depth 1.
        tolerance: largest difference of the inverse depths of a pixel.
        weight: of one pixel and channel.

    Returns:
        Gradients in alpha and depth [H, W] of the photo's camera and in the colours [3, H, W] of
        the shifted one, float32, in a buffer that is reused once unreferenced.
    """
    gradients = _lender.lend([alpha.shape, alpha.shape, photo.shape])
    numbers = np.float32(moves), np.float32(tolerance), np.float32(weight)
    run_blocks(binocular_rows, alpha, depth, *beside, photo, mask, *numbers, *gradients)
    in_alpha, in_depth, in_rgb = gradients
    return in_alpha, in_depth, in_rgb
