"""Projection beside an independent library: means and covariances on the screen by kornia."""

import pytest
import torch
from kornia.geometry.camera.perspective import project_points
from kornia.geometry.conversions import quaternion_to_rotation_matrix
from torch import Tensor
from torch.func import jacrev, vmap

from framework.kernels.reference import project
from tests.numerics.scenes import random_case


@pytest.mark.parametrize("seed", range(4))
def test_means_and_covariances_equal_kornia_s(seed: int) -> None:
    """Pinhole projection, its derivative by autograd, rotations from wxyz quaternions."""
    case = random_case(seed)
    gaussians, camera = case.gaussians.map(Tensor.double), case.camera
    seen = project(gaussians, camera)
    rotation, translation = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    kept = gaussians[seen.index]
    points = kept.means @ rotation.T + translation

    def on_screen(point: Tensor) -> Tensor:
        return project_points(point[None], camera.K[None])[0]

    torch.testing.assert_close(seen.means2d, vmap(on_screen)(points), rtol=1e-9, atol=1e-9)
    unit = torch.nn.functional.normalize(kept.quats, dim=1)
    axes = quaternion_to_rotation_matrix(unit) * kept.scales[:, None, :]
    half = vmap(jacrev(on_screen))(points) @ rotation @ axes
    covariance = half @ half.mT + camera.dilation * torch.eye(2, dtype=torch.float64)
    torch.testing.assert_close(seen.cov2d, covariance, rtol=1e-8, atol=1e-8)
