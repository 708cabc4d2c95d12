"""Transfers pixels with depth from one camera to another.

A point at pixel x = (X, Y, 1) with depth z in camera `a` is in camera `b` at the homogeneous pixel
z A x + t, whose third coordinate is its depth there. The centre of pixel (0, 0) is at 0.5.

    A = K_b R_b R_a^T K_a^-1
    t = K_b (t_b - R_b R_a^T t_a)

Source: Hartley & Zisserman, 2004, section 13.1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from framework.compute.portable import inverse, product

if TYPE_CHECKING:
    from framework.types import Camera


def pixel_transfer(a: Camera, b: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A [3, 3] and t [3] that carry pixels of `a` over to `b`."""
    K_a, K_b = a.K.numpy(), b.K.numpy()
    pose_a, pose_b = a.viewmat.numpy(), b.viewmat.numpy()
    rotation = product(pose_b[:3, :3], pose_a[:3, :3].T)
    translation = pose_b[:3, 3] - product(rotation, pose_a[:3, 3])
    A = product(product(K_b, rotation), inverse(K_a))
    return A, product(K_b, translation)


def project(camera: Camera, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """[M, 3] world points to [M, 3] rows (u, v, z): pixels and depth; u, v are NaN where z <= 0."""
    pose = camera.viewmat.numpy()
    image = product(product(xyz, pose[:3, :3].T) + pose[:3, 3], camera.K.numpy().T)
    z = image[:, 2]
    safe = np.where(z > 0, z, np.nan)
    return np.stack([image[:, 0] / safe, image[:, 1] / safe, z], axis=1)


def inside(camera: Camera, uvz: NDArray[np.float64]) -> NDArray[np.bool_]:
    """[M] whether a projected point lies in front of the camera and in its image."""
    u, v, z = uvz.T
    return (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
