"""Pixels worked out by hand, for the reference and for the kernels.

The camera is the identity with fx = fy = 100 px on a 64x32 image, principal point (20.5, 10.5), so
a Gaussian on the optical axis is centred on pixel (20, 10). With scale 0.02 at z = 2 its footprint
is 100 / 2 x 0.02 = 1 px wide, and its variance with the dilation 1.3 px^2.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.kernels import rasterize
from framework.kernels.reference import rasterize_reference
from framework.types import Camera, Gaussians, Render

CAMERA = Camera(torch.eye(4), torch.tensor([[100.0, 0, 20.5], [0, 100, 10.5], [0, 0, 1]]), 64, 32)
Y0, Y1 = 0.5 / math.sqrt(math.pi), math.sqrt(3 / (4 * math.pi))
RED, GREEN = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)

both = pytest.mark.parametrize("render", [rasterize, rasterize_reference])
Rasterizer = Callable[..., Render]


def _gaussians(
    means: list[tuple[float, float, float]],
    opacities: list[float],
    colors: list[tuple[float, float, float]],
    scale: float = 0.02,
) -> Gaussians:
    """Isotropic Gaussians of constant colour."""
    n = len(means)
    opacity = torch.tensor(opacities)
    return Gaussians(
        means=torch.tensor(means, dtype=torch.float32),
        quats=torch.tensor([[2.0, 0, 0, 0]]).repeat(n, 1),
        log_scales=torch.full((n, 3), math.log(scale)),
        opacity_logits=(opacity / (1 - opacity)).log(),
        sh0=(torch.tensor(colors)[:, None] - 0.5) / Y0,
        shN=torch.zeros(n, 0, 3),
    )


def _close(actual: torch.Tensor, expected: object, tolerance: float = 2e-6) -> None:
    torch.testing.assert_close(
        actual.double(), torch.as_tensor(expected).double(), rtol=tolerance, atol=tolerance
    )


@both
def test_one_gaussian(render: Rasterizer) -> None:
    seen = render(_gaussians([(0, 0, 2)], [0.5], [(0.2, 0.4, 0.8)]), CAMERA)
    _close(seen.rgb[:, 10, 20], [0.1, 0.2, 0.4])
    _close(seen.alpha[10, 20], 0.5)
    _close(seen.depth[10, 20], 1.0)
    _close(seen.alpha[12, 21], 0.5 * math.exp(-0.5 * (1 + 4) / 1.3))
    _close(seen.radii, [math.sqrt(2 * math.log(255 * 0.5) * 1.3)])


@both
def test_one_gaussian_on_a_background(render: Rasterizer) -> None:
    gaussians = _gaussians([(0, 0, 2)], [0.75], [RED])
    seen = render(gaussians, CAMERA, background=torch.tensor([0.4, 0.8, 1.0]))
    _close(seen.rgb[:, 10, 20], [0.75 + 0.25 * 0.4, 0.25 * 0.8, 0.25])
    _close(seen.rgb[:, 31, 63], [0.4, 0.8, 1.0])


@both
def test_two_gaussians_blend_front_to_back(render: Rasterizer) -> None:
    """The nearer one is stored last: w1 = 0.6, w2 = (1 - 0.6) 0.5."""
    gaussians = _gaussians([(0, 0, 4), (0, 0, 2)], [0.5, 0.6], [GREEN, RED])
    seen = render(gaussians, CAMERA)
    _close(seen.rgb[:, 10, 20], [0.6, 0.2, 0.0])
    _close(seen.alpha[10, 20], 0.8)
    _close(seen.depth[10, 20], 0.6 * 2 + 0.2 * 4)


@both
def test_equal_depths_blend_in_stored_order(render: Rasterizer) -> None:
    gaussians = _gaussians([(0, 0, 2), (0, 0, 2)], [0.5, 0.5], [GREEN, RED])
    _close(render(gaussians, CAMERA).rgb[:, 10, 20], [0.25, 0.5, 0.0])


@both
def test_perspective_stretches_off_axis(render: Rasterizer) -> None:
    """At x/z = 0.1: J = [[50, 0, -5], [0, 50, 0]], so var_x = 0.02^2 (50^2 + 5^2) + 0.3."""
    seen = render(_gaussians([(0.2, 0, 2)], [0.5], [RED]), CAMERA)
    _close(seen.alpha[10, 30], 0.5)
    _close(seen.alpha[10, 31], 0.5 * math.exp(-0.5 / (0.0004 * 2525 + 0.3)))
    _close(seen.alpha[11, 30], 0.5 * math.exp(-0.5 / 1.3))


@both
def test_rotation_turns_the_long_axis(render: Rasterizer) -> None:
    """Scales (3, 1, 1) px turned by 90 degrees about z: the long axis is vertical."""
    gaussians = _gaussians([(0, 0, 2)], [0.5], [RED]).replace(
        quats=torch.tensor([[1.0, 0, 0, 1]]), log_scales=torch.tensor([[0.06, 0.02, 0.02]]).log()
    )
    seen = render(gaussians, CAMERA)
    _close(seen.alpha[13, 20], 0.5 * math.exp(-0.5 * 9 / 9.3))
    _close(seen.alpha[10, 23], 0.5 * math.exp(-0.5 * 9 / 1.3))


@both
def test_alpha_is_clamped_and_has_no_gradient_there(render: Rasterizer) -> None:
    gaussians = _gaussians([(0, 0, 2)], [0.999], [RED])
    logits = gaussians.opacity_logits.requires_grad_()
    seen = render(gaussians, CAMERA)
    _close(seen.alpha[10, 20], 0.99)
    seen.alpha[10, 20].backward()
    assert logits.grad is not None and logits.grad.item() == 0.0


@both
def test_a_pixel_stops_before_falling_below_the_threshold(render: Rasterizer) -> None:
    """alpha 0.95: T = 0.05, 0.0025, 1.25e-4; the fourth would leave 6e-6 and is not blended."""
    means = [(0.0, 0.0, 2.0 + 0.1 * k) for k in range(5)]
    seen = render(_gaussians(means, [0.95] * 5, [RED, RED, RED, GREEN, GREEN]), CAMERA)
    _close(1 - seen.alpha[10, 20], 1.25e-4, tolerance=1e-6)
    _close(seen.rgb[:, 10, 20], [1 - 1.25e-4, 0.0, 0.0])


@both
def test_pairs_below_one_255th_are_skipped(render: Rasterizer) -> None:
    seen = render(_gaussians([(0, 0, 2)], [0.5], [RED]), CAMERA)
    falloff = 0.5 * np.exp(-0.5 * (np.arange(64) - 20.0) ** 2 / 1.3)
    expected = np.where(falloff >= 1 / 255, falloff, 0.0)
    assert (expected > 0).sum() == 7
    _close(seen.alpha[10], expected)
    assert (seen.alpha[10].numpy()[expected == 0] == 0).all()


@both
@pytest.mark.parametrize(
    ("mean", "opacity", "visible"),
    [
        ((0, 0, 0.51), 0.5, True),
        ((0, 0, 0.49), 0.5, False),  # nearer than `near`
        ((0, 0, -2), 0.5, False),
        ((0, 0, 2), 0.0040, True),
        ((0, 0, 2), 0.0039, False),  # fainter than 1/255 = 0.00392
        ((0.02 * (11.5 + 47.9), 0, 2), 0.5, True),  # 47.9 of 48 = 0.75 W px from the middle
        ((0.02 * (11.5 + 48.1), 0, 2), 0.5, False),
        ((0, 0.02 * (5.5 + 23.9), 2), 0.5, True),
        ((0, 0.02 * (5.5 + 24.1), 2), 0.5, False),
    ],
)
def test_culling(
    render: Rasterizer, mean: tuple[float, float, float], opacity: float, visible: bool
) -> None:
    """Footprints of 50 px reach the image even from beyond its border, unless culled."""
    seen = render(_gaussians([mean], [opacity], [RED], scale=1.0), CAMERA, near=0.5)
    assert bool(seen.radii[0] > 0) == visible
    assert bool(seen.alpha.max() > 0) == visible


@both
def test_colour_follows_the_direction_and_stops_at_zero(render: Rasterizer) -> None:
    """On the optical axis d = (0, 0, 1): the degree-1 basis is (0, Y1, 0)."""
    gaussians = _gaussians([(0, 0, 2)], [0.5], [(0.2, 0.2, 0.2)])
    shN = torch.zeros(1, 3, 3)
    shN[0, 1] = torch.tensor([0.3, 0.0, -1.0])
    shN[0, 0] = shN[0, 2] = 7.0
    gaussians = gaussians.replace(shN=shN)
    seen = render(gaussians, CAMERA)
    _close(seen.rgb[:, 10, 20], [0.5 * (0.2 + 0.3 * Y1), 0.1, 0.0])
    _close(render(gaussians, CAMERA, sh_degree=0).rgb[:, 10, 20], [0.1, 0.1, 0.1])


@both
def test_factors_multiply_opacities(render: Rasterizer) -> None:
    gaussians = _gaussians([(0, 0, 4), (0, 0, 2)], [0.5, 0.6], [GREEN, RED])
    seen = render(gaussians, CAMERA, opacity_factors=torch.tensor([1.0, 0.5]))
    _close(seen.rgb[:, 10, 20], [0.3, 0.35, 0.0])


@both
def test_offset_moves_the_footprint_and_gets_the_screen_gradient(render: Rasterizer) -> None:
    """alpha(dx) = 0.5 exp(-dx^2 / 2.6) at dx = 1 - offset: d alpha / d offset = alpha / 1.3."""
    gaussians = _gaussians([(0, 0, 2)], [0.5], [RED])
    moved = render(gaussians, CAMERA, means2d_offset=torch.tensor([[3.0, -2.0]]))
    _close(moved.alpha[8, 23], 0.5)
    offset = torch.zeros(1, 2, requires_grad=True)
    alpha = render(gaussians, CAMERA, means2d_offset=offset).alpha[10, 21]
    alpha.backward()
    _close(offset.grad, [[float(alpha.detach()) / 1.3, 0.0]])  # type: ignore[arg-type]


@both
def test_a_smaller_image_is_the_mean_of_the_larger(render: Rasterizer) -> None:
    """The smaller camera's dilation is that of a mean over 2x2 pixels. 0.3 of the larger pixels
    would blur a Gaussian of one pixel."""
    gaussians = _gaussians([(0.005, 0.005, 2)], [0.5], [RED], scale=0.02)
    mean = render(gaussians, CAMERA).alpha.unfold(0, 2, 2).unfold(1, 2, 2).mean((-1, -2))
    small = CAMERA.scaled(2)
    assert small.dilation == pytest.approx((0.3 + 0.25) / 4)
    blurred = replace(small, dilation=0.3)
    error = float((render(gaussians, small).alpha - mean).abs().sum())
    assert error < 0.5 * float((render(gaussians, blurred).alpha - mean).abs().sum())


@pytest.mark.parametrize("dilation", [0.0, -0.3, math.nan, math.inf])
def test_a_camera_without_a_dilation_is_refused(dilation: float) -> None:
    with pytest.raises(UserError, match="expected a finite dilation above 0"):
        replace(CAMERA, dilation=dilation)
