"""Inverse depth between the sparse points that a view sees.

Their Delaunay triangles in the image are taken for planes of the scene, on which inverse depth is
linear in pixels; beyond them it is that of the nearest point.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import Delaunay, QhullError, cKDTree

from framework.compute.jit import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

FEWEST_POINTS = 10
EDGE = 1e-9  # barycentric: pixel centres on an edge belong to both triangles


@kernel
def draw_triangles(corners, values, image):  # type: ignore[no-untyped-def]
    """Kernel: values [T, 3] float64, linear between the corners [T, 3, 2] float64 (x, y) of each
    triangle, into image [H, W] float64, at pixel centres (+ 0.5); later triangles win."""
    height, width = image.shape
    for i in range(corners.shape[0]):
        ax, ay = corners[i, 0]
        bx, by = corners[i, 1]
        cx, cy = corners[i, 2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        if area == 0.0:
            continue
        first = max(0, int(math.floor(min(ay, by, cy) - 0.5)))
        last = min(height, int(math.ceil(max(ay, by, cy) + 0.5)))
        left = max(0, int(math.floor(min(ax, bx, cx) - 0.5)))
        right = min(width, int(math.ceil(max(ax, bx, cx) + 0.5)))
        for y in range(first, last):
            for x in range(left, right):
                px, py = x + 0.5, y + 0.5
                a = ((bx - px) * (cy - py) - (cx - px) * (by - py)) / area
                b = ((cx - px) * (ay - py) - (ax - px) * (cy - py)) / area
                c = 1.0 - a - b
                if a >= -EDGE and b >= -EDGE and c >= -EDGE:
                    image[y, x] = a * values[i, 0] + b * values[i, 1] + c * values[i, 2]


def between(uv: Array, inverse: Array, wanted: NDArray[np.bool_]) -> Array | None:
    """[H, W] float64 inverse depth at the `wanted` [H, W] pixels, 0 elsewhere; None where the
    points span no triangle, or are fewer than ten.

    uv: [P, 2] pixels inside the image. inverse: [P], > 0, any unit.
    """
    if len(uv) < FEWEST_POINTS:
        return None
    try:
        corners = Delaunay(uv).simplices
    except QhullError:  # all on a line
        return None
    image = np.zeros(wanted.shape)
    draw_triangles(np.ascontiguousarray(uv[corners]), inverse[corners], image)
    beyond = wanted & (image == 0)
    rows, columns = np.nonzero(beyond)
    _, nearest = cKDTree(uv).query(np.column_stack([columns, rows]) + 0.5)
    image[beyond] = inverse[nearest]
    return np.where(wanted, image, 0.0)
