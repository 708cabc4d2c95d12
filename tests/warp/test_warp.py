"""Warping: proofs on the ray-traced stage with exact depth (see `stage.py`)."""

import numpy as np
import pytest
import torch

from framework.types import Camera, DepthMap, View
from framework.warp.zbuffer import Warped, prepare, warp
from tests.warp.stage import HALF, SQUARE, camera, exact, photograph


def stage_views(unit: float = 1.0) -> list[View]:
    places = ((-0.5, 0.0), (0.5, 0.1), (0.0, -0.4))
    return [photograph(camera(x, y, unit=unit), unit=unit) for x, y in places]


def warp_exact(views: list[View], target: Camera, **options: float) -> Warped:
    return warp(prepare(views, [exact(view) for view in views]), target, **options)


def masked_psnr(warped: Warped, image: torch.Tensor) -> float:
    error = ((warped.image - image).double() ** 2).mean(0)[warped.mask > 0].mean()
    return float(-10 * torch.log10(error + 1e-15))


def test_a_view_warped_into_itself_returns_it() -> None:
    view = stage_views()[0]
    warped = warp_exact([view], view.camera)
    assert masked_psnr(warped, view.image) > 60
    assert warped.coverage > 0.9
    assert view.depth is not None
    inside = warped.mask > 0
    torch.testing.assert_close(warped.depth[inside], view.depth[inside], rtol=1e-5, atol=0)


@pytest.mark.parametrize(
    ("target", "least_coverage"),
    [
        (camera(0.1, 0.05), 0.9),
        (camera(0.2, 0.0, 0.2, yaw=0.03), 0.9),
        (camera(0.0, 0.0, -1.0), 0.7),
    ],
)
def test_a_new_view_is_what_ray_tracing_shows(target: Camera, least_coverage: float) -> None:
    truth = photograph(target)
    warped = warp_exact(stage_views(), target)
    assert masked_psnr(warped, truth.image) > 40
    assert warped.coverage > least_coverage
    assert truth.depth is not None
    error = (warped.depth - truth.depth).abs() / truth.depth
    assert float(error[warped.mask > 0].max()) < 2e-3


def test_magnification_leaves_no_holes() -> None:
    target = camera(0.0, 0.0, 2.0)  # the square is seen at three times the size
    truth = photograph(target)
    warped = warp_exact([photograph(camera())], target)
    square = torch.zeros_like(warped.mask, dtype=torch.bool)
    square[10:-10, 40:-40] = True
    assert bool((warped.mask[square] > 0).all())
    assert masked_psnr(warped, truth.image) > 35


def test_the_foreground_hides_the_background() -> None:
    """The square moves by 30 px, the wall by about 13: where both land only the square shows."""
    target = camera(0.55, 0.0)
    warped = warp_exact([photograph(camera())], target)
    plain = warp_exact([photograph(camera(), square=False)], target)
    x0, x1 = ((s * HALF - 0.55) / SQUARE * 160 + 80 for s in (-1, 1))
    inside = (slice(25, 95), slice(int(x0) + 4, int(x1) - 4))
    assert bool((warped.mask[inside] > 0).all())
    torch.testing.assert_close(
        warped.depth[inside], torch.full_like(warped.depth[inside], SQUARE), rtol=1e-4, atol=0
    )
    assert bool((plain.depth[inside] > 5).all())


def test_what_no_support_saw_is_masked_out() -> None:
    """Right of the square's new place lies wall that the square hid in the only support."""
    target = camera(0.55, 0.0)
    warped = warp_exact([photograph(camera())], target)
    hidden_from = int((HALF - 0.55) / SQUARE * 160 + 80) + 2
    assert not (warped.mask[40:80, hidden_from : hidden_from + 8] > 0).any()


def test_only_trusted_depth_enters() -> None:
    view = stage_views()[0]
    trusted = exact(view)
    confidence = trusted.confidence.clone()
    confidence[:, :80] = 0
    depth = trusted.depth.clone()
    depth[:20] = 0
    depth[-20:] = float("nan")
    warped = warp(prepare([view], [DepthMap(depth, confidence)]), view.camera)
    assert not warped.mask[:, :80].any() and not warped.mask[:20].any()
    assert not warped.mask[-20:].any() and warped.mask[40:60, 90:140].all()


def test_a_camera_that_looks_away_sees_nothing() -> None:
    warped = warp_exact(stage_views(), camera(yaw=np.pi))
    assert warped.coverage == 0.0 and not warped.image.any()
