"""Geometry against scipy, hand-computed values, round trips and float64 gradient checks."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from framework.compute.rng import stream
from framework.geometry import (
    axis_angle_matrix,
    perturbed,
    project,
    quaternions,
    rotation_matrices,
    unproject,
)
from framework.types import Camera
from tests.init.synthetic import camera


def random_quats(n: int) -> torch.Tensor:
    return torch.from_numpy(stream(0, "test/quats").standard_normal((n, 4)))


def test_rotation_matrices_agree_with_scipy() -> None:
    quats = random_quats(50)
    expected = Rotation.from_quat(quats[:, [1, 2, 3, 0]].numpy()).as_matrix()
    np.testing.assert_allclose(rotation_matrices(quats).numpy(), expected, atol=1e-14)


def test_quaternions_invert_rotation_matrices() -> None:
    quats = random_quats(200)
    quats = quats / quats.norm(dim=1, keepdim=True) * quats[:, :1].sign()
    torch.testing.assert_close(quaternions(rotation_matrices(quats)), quats, atol=1e-14, rtol=0)


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [0.3, -2.0, 1.1]])
def test_axis_angle_agrees_with_scipy(vector: list[float]) -> None:
    got = axis_angle_matrix(torch.tensor(vector, dtype=torch.float64))
    np.testing.assert_allclose(got.numpy(), Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)


def test_projection_of_a_point_by_hand() -> None:
    K = torch.tensor([[100.0, 0, 20], [0, 50, 10], [0, 0, 1]])
    viewmat = torch.eye(4)
    viewmat[:3, 3] = torch.tensor([1.0, 0.0, 2.0])
    uv, z = project(torch.tensor([[0.0, 1.0, 2.0]]), Camera(viewmat, K, 40, 20))
    assert uv.tolist() == [[45.0, 22.5]]  # 100 * 1/4 + 20, 50 * 1/4 + 10
    assert z.tolist() == [4.0]


def test_project_inverts_unproject_at_pixel_centres() -> None:
    view = camera(0.4, 0.3)
    depth = torch.from_numpy(stream(0, "test/depth").uniform(1, 9, (view.height, view.width)))
    uv, z = project(unproject(depth, view), view)
    torch.testing.assert_close(z, depth)
    y, x = torch.meshgrid(torch.arange(view.height), torch.arange(view.width), indexing="ij")
    torch.testing.assert_close(
        uv, torch.stack([x, y], -1) + 0.5, atol=1e-10, rtol=0, check_dtype=False
    )


def test_perturbed_turns_and_moves_by_what_was_asked() -> None:
    start, turn = camera(0.4, 0.3), torch.tensor([0.02, -0.03, 0.01])
    shift = torch.tensor([0.1, -0.2, 0.3])
    end = perturbed(start, turn, shift)
    torch.testing.assert_close(end.center, start.center + shift, check_dtype=False)
    relative = (end.viewmat @ torch.linalg.inv(start.viewmat))[:3, :3]
    np.testing.assert_allclose(Rotation.from_matrix(relative.numpy()).as_rotvec(), turn, atol=1e-8)
    assert torch.equal(end.K, start.K)


def test_gradients() -> None:
    quats = random_quats(3).requires_grad_()
    points = torch.from_numpy(stream(0, "test/points").uniform(2, 4, (3, 3))).requires_grad_()
    assert torch.autograd.gradcheck(rotation_matrices, quats)
    assert torch.autograd.gradcheck(lambda p: project(p, camera(0.1, 0.1)), points)
