"""Moves a model as viewers expect it: upright, with its middle at the origin.

A trained model is in the world of its photos, whose orientation is arbitrary. Viewers assume that
the y axis of a splat PLY points down, as in COLMAP's first camera, and orbit around the origin. So
the model is turned (its mean camera is upright and looks along +z) and moved (the point that the
cameras look at is the origin). It is not scaled.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from framework.exports.flight import Array, Rig, looking, unit

if TYPE_CHECKING:
    from torch import Tensor

    from framework.exports.opened import OpenedRun
    from framework.types import Camera, Gaussians

LEVEL = 1e-6  # a direction with less of it along the ground is up or down
SAMPLES = 64  # directions at which turned harmonics are compared; 16 would do


def upright(poses: Rig, distance: float) -> Array:
    """[4, 4] from the world of the rig to the upright one.

    Args:
        distance: of the middle from the mean camera, if all cameras look the same way; otherwise
            the middle is where their axes meet.
    """
    forward = poses.forward.mean(axis=0)
    if np.linalg.norm(forward) < 0.1:  # all around, level: any direction is as good
        forward = poses.forward[0]
    turn = looking(np.zeros(3), forward, -poses.up)[:3, :3]
    if poses.kind == "orbit":  # tilted cameras must not tilt the ground
        ahead = [way - poses.up * (way @ poses.up) for way in (forward, *poses.forward)]
        level = unit(next((way for way in ahead if np.linalg.norm(way) > LEVEL), ahead[0]))
        turn = looking(np.zeros(3), level, -poses.up)[:3, :3]
        middle = poses.focus
    else:
        middle = poses.centers.mean(axis=0) + distance * unit(forward)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = turn, -turn @ middle
    return moved


def moved_run(run: OpenedRun, motion: Array) -> OpenedRun:
    """The run after a rigid motion [4, 4], with its cameras."""
    cameras = [
        replace(named, viewmat=moved_camera(named.camera, motion).viewmat.numpy())
        for named in run.cameras
    ]
    gaussians = moved_gaussians(run.gaussians, motion)
    return replace(run, gaussians=gaussians, cameras=tuple(cameras))


def moved_camera(camera: Camera, motion: Array) -> Camera:
    """The camera that sees the same of the moved scene."""
    import torch

    return replace(camera, viewmat=camera.viewmat @ torch.from_numpy(np.linalg.inv(motion)))


def moved_gaussians(gaussians: Gaussians, motion: Array) -> Gaussians:
    """The Gaussians after a rigid motion [4, 4]; colours turn with them."""
    import torch

    from framework.geometry import quaternions, rotation_matrices

    turn = torch.from_numpy(motion[:3, :3])
    means = gaussians.means.double() @ turn.T + torch.from_numpy(motion[:3, 3])
    quats = quaternions(turn @ rotation_matrices(gaussians.quats.double()))
    return gaussians.replace(
        means=means.float(), quats=quats.float(), shN=turned_bands(gaussians.shN, turn)
    )


def turned_bands(shN: Tensor, turn: Tensor) -> Tensor:
    """Rotate SH coefficients [M, K-1, 3] above degree 0 by `turn` [3, 3].

    A rotation maps each degree to itself: Y(R^T d) = D Y(d) for all directions d, with one matrix D
    per degree. D is fitted to sampled directions by least squares (Ivanic and Ruedenberg 1996 give
    it in closed form). Coefficients c become D^T c.
    """
    import torch

    from framework.kernels.reference import sh_basis
    from framework.types import degree_of

    if shN.numel() == 0:
        return shN
    degree = degree_of(shN.shape[1])
    random = torch.Generator().manual_seed(0)
    directions = torch.randn(SAMPLES, 3, generator=random, dtype=torch.float64)
    directions = torch.nn.functional.normalize(directions, dim=1)
    after = sh_basis(directions, degree)
    before = sh_basis(directions @ turn.double(), degree)
    parts = []
    for band in range(1, degree + 1):
        columns = slice(band**2, (band + 1) ** 2)
        D = torch.linalg.lstsq(after[:, columns], before[:, columns]).solution  # before = after D
        kept = shN[:, band**2 - 1 : (band + 1) ** 2 - 1].double()
        parts.append(torch.einsum("ab,nbc->nac", D, kept))
    return torch.cat(parts, dim=1).to(shN.dtype)
