"""Conventions of camera poses in files: `AXES_WAY`, for instance `opengl_c2w`.

Axes: `opencv` (x right, y down, z forward), `opengl` (x right, y up, z backward) or `llff` (x down,
y right, z backward). Way: `c2w`, camera-to-world, or `w2c`, its inverse. Loaders decode poses by
their layout's convention; `scene.poses` chooses another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from framework.compute.elementary import product
from framework.scenes.cameras import center_of

if TYPE_CHECKING:
    from framework.types import TrainingSet

CONVENTIONS = ("opencv_c2w", "opencv_w2c", "opengl_c2w", "opengl_w2c", "llff_c2w", "llff_w2c")
AXES = {  # a vector in the file's camera axes -> in OpenCV's
    "opencv": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "opengl": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "llff": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
}


def decoded_as(viewmat: NDArray[np.float64], layout: str, other: str) -> NDArray[np.float64]:
    """Decode under convention `other` a pose that was decoded under `layout`.

    Args:
        viewmat: [4, 4] OpenCV world-to-camera, decoded under `layout`.
        layout, other: two of `CONVENTIONS`.

    Returns:
        [4, 4] OpenCV world-to-camera.
    """
    if layout == other:
        return viewmat
    (axes, way), (new_axes, new_way) = layout.split("_"), other.split("_")
    written = product(_axes(axes).T, viewmat)  # the file's matrix as w2c
    if way != new_way:
        written = _inverse(written)
    return product(_axes(new_axes), written)


def repaired(training: TrainingSet, layout: str, other: str) -> TrainingSet:
    """The training set with its poses decoded under `other` instead of `layout`."""
    import torch

    views = []
    for view in training.views:
        viewmat = torch.from_numpy(decoded_as(view.camera.viewmat.numpy(), layout, other))
        views.append(replace(view, camera=replace(view.camera, viewmat=viewmat)))
    return replace(training, views=tuple(views))


def _axes(name: str) -> NDArray[np.float64]:
    """[4, 4] from the file's camera axes to OpenCV's."""
    matrix = np.eye(4)
    matrix[:3, :3] = AXES[name]
    return matrix


def _inverse(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The inverse of a rigid motion [4, 4]."""
    inverse = np.eye(4)
    inverse[:3, :3] = pose[:3, :3].T
    inverse[:3, 3] = center_of(pose)
    return inverse
