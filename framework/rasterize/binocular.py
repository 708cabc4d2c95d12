"""A photo seen again through a render from beside it: the loss's gradient in both renders.

Binocular-Guided 3DGS (Han et al. 2024, arXiv 2410.18822, section 3.1): the camera moves by t along
its own x axis, so a pixel at depth D moves along its row by -f t / D. What the moved camera sees
there should be what the photo shows: mean over pixels and channels of |warped - photo|. A pixel
counts (ours) where its depth is that of the render beside it, as elsewhere one hides the other, or
one of the two depths is wrong and its colour would be painted on what lies behind.
"""

from __future__ import annotations

import threading
from typing import Any

import numpy as np

from framework.compute.jit import inlined, kernel
from framework.compute.parallel import run_blocks
from framework.rasterize.lending import Lender
from framework.rasterize.roughness import SEEN

WHOLE = np.float32(0.999)  # a pixel of a mask that covers no less
_NONE, _ZERO, _ONE = np.float32(-1), np.float32(0), np.float32(1)


@inlined
def _disparities(alpha: Any, depth: Any, into: Any) -> None:
    """Inverse expected depth of a row; -1 where nothing is seen."""
    for x in range(len(into)):
        into[x] = alpha[x] / depth[x] if (alpha[x] > SEEN) & (depth[x] > _ZERO) else _NONE


@kernel
def binocular_rows(
    block: int,
    blocks: int,
    alpha: Any,
    depth: Any,
    rgb_beside: Any,
    alpha_beside: Any,
    depth_beside: Any,
    photo: Any,
    mask: Any,
    moves: Any,
    tolerance: Any,
    weight: Any,
    in_alpha: Any,
    in_depth: Any,
    in_rgb: Any,
) -> None:
    """A range of rows of the gradients: in alpha and depth [H, W] of the photo's camera, and in the
    colours [3, H, W] that the camera beside it sees. The other arguments: `binocular_gradient`."""
    height, width = alpha.shape
    own, beside = np.empty(width, np.float32), np.empty(width, np.float32)
    for y in range(height * block // blocks, height * (block + 1) // blocks):
        _disparities(alpha[y], depth[y], own)
        _disparities(alpha_beside[y], depth_beside[y], beside)
        in_alpha[y], in_depth[y] = _ZERO, _ZERO
        in_rgb[:, y] = _ZERO
        for x in range(width):
            d = own[x]
            there = np.float32(x) - moves * d
            if not ((d > _ZERO) & (mask[y, x] > WHOLE) & (there >= _ZERO) & (there <= width - 1)):
                continue
            left = min(int(there), max(width - 2, 0))
            right = min(left + 1, width - 1)
            share = there - np.float32(left)
            if (beside[left] < _ZERO) | (beside[right] < _ZERO):
                continue
            seen = beside[left] + share * (beside[right] - beside[left])
            if abs(seen - d) >= tolerance:
                continue
            slope = _ZERO
            for c in range(3):
                near, far = rgb_beside[c, y, left], rgb_beside[c, y, right]
                error = near + share * (far - near) - photo[c, y, x]
                pull = weight if error > _ZERO else (-weight if error < _ZERO else _ZERO)
                in_rgb[c, y, left] += pull * (_ONE - share)
                in_rgb[c, y, right] += pull * share
                slope += pull * (far - near)
            in_alpha[y, x] = -moves * slope / depth[y, x]
            in_depth[y, x] = -in_alpha[y, x] * d


_own = threading.local()


def binocular_gradient(
    alpha: np.ndarray,
    depth: np.ndarray,
    beside: tuple[np.ndarray, np.ndarray, np.ndarray],
    photo: np.ndarray,
    mask: np.ndarray,
    moves: float,
    tolerance: float,
    weight: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The gradients in alpha and depth [H, W] of the photo's camera and in the colours [3, H, W] of
    the camera beside it, all float32, in memory that is lent again once nobody holds it.

    beside: colours, alpha and depth that the moved camera sees. photo [3, H, W]: multiplied by mask
    [H, W]. moves: f t, pixels that a point at depth 1 moves to the left. tolerance: by which the
    inverse depths of a pixel may differ. weight: of a pixel and channel.
    """
    if not hasattr(_own, "lender"):
        _own.lender = Lender()  # this thread's, as trainings may run at the same time
    found = _own.lender.lend([alpha.shape, alpha.shape, photo.shape])
    numbers = np.float32(moves), np.float32(tolerance), np.float32(weight)
    run_blocks(binocular_rows, alpha, depth, *beside, photo, mask, *numbers, *found)
    return tuple(found)
