"""`init=sparse`, the background colours and the registry of initialisations."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.initialize import Sparse
from framework.initialize.background import background_color
from framework.types import Gaussians
from tests.init.synthetic import camera, points, scene


def build(xyz: np.ndarray, options: Sparse | None = None, degree: int = 0) -> Gaussians:
    training, depth = scene([camera(-1.0), camera(1.0)])
    training = replace(training, points=points(xyz))
    return (options or Sparse()).build(training, depth, degree, seed=0)


def test_scales_are_root_mean_squared_neighbour_distances() -> None:
    gaussians = build(np.array([[0.0, 0, 5], [3, 0, 5], [0, 4, 5], [3, 4, 5]]), degree=3)
    expected = np.sqrt((9 + 16 + 25) / 3)  # a 3 x 4 rectangle: the same for every corner
    torch.testing.assert_close(gaussians.scales, torch.full((4, 3), expected, dtype=torch.float32))
    assert gaussians.sh_degree == 3 and (gaussians.sh0.abs() < 1e-6).all()
    torch.testing.assert_close(gaussians.opacities, torch.full((4,), 0.1))


@pytest.mark.parametrize("n", [0, 3])
def test_too_few_points_name_the_way_out(n: int) -> None:
    with pytest.raises(UserError, match=rf"init=sparse: .* got {n}; use init=stereo"):
        build(np.zeros((n, 3)))


def test_mean_background_counts_valid_pixels_of_all_sizes() -> None:
    training, _ = scene([camera(0.0), camera(0.1, 0.0, 80, 60)])
    mask = torch.zeros(48, 64)
    mask[:24] = 1
    views = (
        replace(training.views[0], image=torch.full((3, 48, 64), 0.25), mask=mask),
        replace(training.views[1], image=torch.full((3, 60, 80), 0.75)),
    )
    expected = (0.25 * 24 * 64 + 0.75 * 60 * 80) / (24 * 64 + 60 * 80)
    color = background_color("mean", replace(training, views=views))
    assert color.dtype == torch.float32
    torch.testing.assert_close(color, torch.full((3,), expected))
