"""Quaternions and pinhole projection: pure functions on torch tensors.

Convention: quaternions are wxyz and need not be normalised; rotation matrices act on column
vectors; cameras are world-to-camera with OpenCV axes and pixel centres at +0.5 (`framework.types`).
Results have the dtype of the first argument, so float64 in gives float64 out.

3x3 products are written out as sums of elementwise products: a BLAS call of this shape is slower
and may round differently with the number of threads.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from framework.compute.portable import inverse, sinc_cosine
from framework.compute.tensors import root
from framework.types import Camera


def rotation_matrices(quats: Tensor) -> Tensor:
    """[..., 3, 3] rotations of `quats` [..., 4] wxyz (normalised here; zero-length is invalid)."""
    w, x, y, z = _normalised(quats).unbind(-1)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def quaternions(rotations: Tensor) -> Tensor:
    """[..., 4] unit quaternions wxyz, w >= 0, of rotation matrices [..., 3, 3].

    With q = (w, x, y, z) the entries of R give all products 4 q_i q_j. The row of the largest
    q_i^2, divided by its norm, is q up to sign. Taking the largest keeps half turns exact (Shepperd
    1978, "Quaternion from rotation matrix").
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in rotations.unbind(-2))
    products = torch.stack(
        [
            torch.stack((1 + a + e + i, h - f, c - g, d - b), -1),
            torch.stack((h - f, 1 + a - e - i, d + b, c + g), -1),
            torch.stack((c - g, d + b, 1 - a + e - i, h + f), -1),
            torch.stack((d - b, c + g, h + f, 1 - a - e + i), -1),
        ],
        -2,
    )
    largest = products.diagonal(dim1=-2, dim2=-1).argmax(-1)
    index = largest[..., None, None].expand(*largest.shape, 1, 4)
    q = products.gather(-2, index).squeeze(-2)
    q = _normalised(q)
    return torch.where(q[..., :1] < 0, -q, q)


def axis_angle_matrix(axis_angle: Tensor) -> Tensor:
    """[3, 3] rotation about the direction of `axis_angle` [3] by its length, in radians.

    Through the quaternion (cos t/2, sin(t/2) v/t), differentiable at 0, too.
    """
    x, y, z = axis_angle.square().unbind()
    sinc, cosine = sinc_cosine((x + y + z) / 4)
    return rotation_matrices(torch.cat([cosine[None], axis_angle / 2 * sinc]))


def project(points: Tensor, camera: Camera) -> tuple[Tensor, Tensor]:
    """Where `camera` sees world `points` [..., 3]: (uv [..., 2] pixels, z [...] camera depth).

    Nothing is culled: for z <= 0 the pixel coordinates mean nothing (infinite at z = 0).
    """
    viewmat, K = camera.viewmat.to(points.dtype), camera.K.to(points.dtype)
    seen = _rotate(viewmat[:3, :3], points) + viewmat[:3, 3]
    z = seen[..., 2]
    image = _rotate(K, seen)
    return image[..., :2] / z[..., None], z


def unproject(depth: Tensor, camera: Camera) -> Tensor:
    """[H, W, 3] world points of the pixel centres at `depth` [H, W] (camera-space z, scene units).

    The inverse of `project`; a depth of 0 gives the camera's centre.

    Raises:
        ValueError: when the map is not of the camera's size.
    """
    if tuple(depth.shape) != (camera.height, camera.width):
        raise ValueError(
            f"unproject: expected a depth map [{camera.height}, {camera.width}] like the camera,"
            f" got {tuple(depth.shape)}"
        )
    inverse_K = torch.from_numpy(inverse(camera.K.numpy())).to(depth.dtype)
    y, x = torch.meshgrid(
        torch.arange(camera.height, dtype=depth.dtype) + 0.5,
        torch.arange(camera.width, dtype=depth.dtype) + 0.5,
        indexing="ij",
    )
    rays = _rotate(inverse_K, torch.stack([x, y, torch.ones_like(x)], -1))
    rotation = camera.viewmat[:3, :3].to(depth.dtype)
    return _rotate(rotation.T, rays * depth[..., None]) + camera.center.to(depth.dtype)


def perturbed(camera: Camera, axis_angle: Tensor, shift: Tensor) -> Camera:
    """`camera` turned by `axis_angle` [3] (radians, about its own axes) with its centre moved by
    `shift` [3] (scene units, along world axes)."""
    turn = axis_angle_matrix(axis_angle.to(torch.float64))
    rotation = _product(turn, camera.viewmat[:3, :3])
    viewmat = camera.viewmat.clone()
    viewmat[:3, :3] = rotation
    viewmat[:3, 3] = -_rotate(rotation, camera.center + shift.to(torch.float64))
    return replace(camera, viewmat=viewmat)


def moved_aside(camera: Camera, shift: float) -> Camera:
    """`camera` with its centre at `shift` (scene units) along its own x axis."""
    viewmat = camera.viewmat.clone()
    viewmat[0, 3] -= shift
    return replace(camera, viewmat=viewmat)


def distance(a: Camera, b: Camera) -> float:
    """The distance of two camera centres, in scene units."""
    x, y, z = (a.center - b.center).tolist()
    return math.sqrt(x * x + y * y + z * z)


def mean_neighbour_distance(cameras: Sequence[Camera]) -> float:
    """Mean distance of a camera to its nearest other one, in scene units; 0 for a single camera."""
    if len(cameras) < 2:
        return 0.0
    nearest = [min(distance(a, b) for b in cameras if b is not a) for a in cameras]
    return sum(nearest) / len(nearest)


def _normalised(q: Tensor) -> Tensor:
    """`q` [..., 4] divided by their lengths, whose squares are summed in one order."""
    w, x, y, z = (q * q).unbind(-1)
    return q / root(w + x + y + z)[..., None]


def _product(a: Tensor, b: Tensor) -> Tensor:
    """[3, 3] = a @ b."""
    return torch.stack([_rotate(a, column) for column in b.unbind(-1)], -1)


def _rotate(matrix: Tensor, vectors: Tensor) -> Tensor:
    """[..., 3] = matrix [3, 3] @ vectors [..., 3]."""
    x, y, z = vectors.unbind(-1)
    return torch.stack([x * row[0] + y * row[1] + z * row[2] for row in matrix], -1)
