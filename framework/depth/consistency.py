"""Cross-view check: does another view's depth map confirm a depth?

Pixel x with depth z is carried over to the other camera (`framework.depth.transfer`), where it lies
at pixel x' with depth z'. The views agree if |z' / D'(x') - 1| < tolerance, D' read at the pixel
that contains x'. This is the left-right check of stereo, written for any pair of pinhole cameras.
"""

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from framework.compute.jit import kernel
from framework.compute.parallel import run_blocks
from framework.depth.transfer import pixel_transfer
from framework.types import Camera, DepthMap, TrainingSet, View

_F = np.float32


@kernel
def count_agreement(block, n_blocks, depth, other, A, t, tolerance, count):
    """Kernel over rows: count[y, x] += 1 where `other` [h, w] confirms `depth` [H, W], both
    float32, 0 = unknown. A [3, 3], t [3] float32. count [H, W] int32."""
    height, width = depth.shape
    rows, columns = _F(other.shape[0]), _F(other.shape[1])
    for y in range(block * height // n_blocks, (block + 1) * height // n_blocks):
        Y = _F(y) + _F(0.5)
        for x in range(width):
            z = depth[y, x]
            if not z > _F(0.0):
                continue
            X = _F(x) + _F(0.5)
            w = z * (A[2, 0] * X + A[2, 1] * Y + A[2, 2]) + t[2]
            if not w > _F(0.0):
                continue
            u = (z * (A[0, 0] * X + A[0, 1] * Y + A[0, 2]) + t[0]) / w
            v = (z * (A[1, 0] * X + A[1, 1] * Y + A[1, 2]) + t[1]) / w
            if u >= _F(0.0) and v >= _F(0.0) and u < columns and v < rows:
                seen = other[np.int64(v), np.int64(u)]
                if seen > _F(0.0) and abs(w / seen - _F(1.0)) < tolerance:
                    count[y, x] += 1


def confirmed(
    training: TrainingSet, depths: Sequence[NDArray[np.float32]], tolerance: float
) -> list[NDArray[np.bool_]]:
    """[H, W] of every view: whether any other view confirms its depth, see `agreeing_views`."""
    cameras, indices = [view.camera for view in training.views], range(len(depths))
    return [
        agreeing_views(depths, cameras, i, [j for j in indices if j != i], tolerance) > 0
        for i in indices
    ]


def depth_map(view: View, depth: NDArray[np.float32], score: NDArray) -> DepthMap:
    """Build a view's depth map with confidence `score`, 0 outside the view's mask."""
    confidence = torch.from_numpy(score.astype(np.float32))
    masked = confidence if view.mask is None else confidence * (view.mask > 0)
    return DepthMap(torch.from_numpy(depth), masked)


def agreeing_views(
    depths: Sequence[NDArray[np.float32]],
    cameras: Sequence[Camera],
    index: int,
    others: Sequence[int],
    tolerance: float,
) -> NDArray[np.int32]:
    """[H, W] int32: how many of `others` confirm the depth of view `index` to the relative
    `tolerance`.

    Args:
        depths: one [H, W] float32 map per view, 0 = unknown (never confirmed).
    """
    count = np.zeros(depths[index].shape, np.int32)
    for other in others:
        A, t = pixel_transfer(cameras[index], cameras[other])
        run_blocks(
            count_agreement, depths[index], depths[other], A.astype(np.float32),
            t.astype(np.float32), np.float32(tolerance), count,
        )  # fmt: skip
    return count
