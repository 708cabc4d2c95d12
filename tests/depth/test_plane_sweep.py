"""The plane sweep on a scene with exact depth: accuracy, laws, and the errors it raises."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.depth.matching.neighbours import depth_bounds
from framework.depth.matching.sweep import plane_count, plane_spacing
from framework.errors import UserError
from framework.types import Camera, DepthMap, TrainingSet
from tests.built import build_provider
from tests.depth.plane import FAR, NEAR, camera, no_points, plane_depth, plane_scene, view


def sweep(training: TrainingSet, **options: float) -> tuple[DepthMap, ...]:
    return build_provider("plane_sweep", options).estimate(training)


@pytest.fixture(scope="module")
def maps() -> tuple[DepthMap, ...]:
    return sweep(plane_scene())


def test_confident_pixels_are_within_one_and_three_percent(maps: tuple[DepthMap, ...]) -> None:
    for actual, of in zip(maps, plane_scene().views, strict=True):
        error = np.abs(actual.depth.numpy() / plane_depth(of.camera) - 1)
        confident = actual.confidence.numpy() > 0
        assert confident.mean() > 0.7
        assert (error[confident] < 0.01).mean() > 0.97
        assert (error[confident] < 0.03).mean() > 0.99


def test_depth_scales_with_the_scene(maps: tuple[DepthMap, ...]) -> None:
    scene = plane_scene()

    def enlarged(of: Camera) -> Camera:
        pose = of.viewmat.clone()
        pose[:3, 3] *= 1000
        return replace(of, viewmat=pose)

    views = tuple(replace(v, camera=enlarged(v.camera)) for v in scene.views)
    large = replace(scene, views=views, near=1000 * scene.near, far=1000 * scene.far)
    for actual, first in zip(sweep(large), maps, strict=True):
        ratio = actual.depth / first.depth / 1000
        assert float(((ratio - 1).abs() < 1e-4).float().mean()) > 0.999


@pytest.mark.parametrize(
    ("spacing", "megapixels", "planes"),
    [(0.0, 1, 96), (1.0, 1, 96), (1.01, 1, 97), (2.0, 1, 191), (9.0, 1, 256), (9.0, 12, 96)],
)
def test_planes_are_a_pixel_apart_within_limits(
    spacing: float, megapixels: int, planes: int
) -> None:
    assert plane_count(spacing, 10**6 * megapixels) == planes


def test_a_wide_baseline_is_searched_at_more_planes() -> None:
    cameras = [camera((x, 0.0, 0.0), (480, 40), 900.0) for x in (-0.5, 0.5)]
    views = tuple(view(str(i), of) for i, of in enumerate(cameras))
    scene = TrainingSet("plane", views, no_points(2), NEAR, FAR)
    spacing = plane_spacing(views, 0, [1], depth_bounds(scene, 0), 96)
    planes = plane_count(spacing, 480 * 40)
    assert 96 < planes < 256
    actual, expected = sweep(scene)[0], sweep(scene, planes=planes)[0]
    assert torch.equal(actual.depth, expected.depth)


def test_a_view_without_overlap_gets_no_depth(caplog: pytest.LogCaptureFixture) -> None:
    scene = plane_scene()
    away = camera((0.0, 0.0, 0.0), (96, 72), 90.0)
    turned = away.viewmat.clone()
    turned[:3, :3] = torch.diag(torch.tensor([-1.0, 1.0, -1.0])).double() @ turned[:3, :3]
    alone = replace(scene.views[0], name="alone", camera=replace(away, viewmat=turned))
    views = (*scene.views, alone)
    actual = sweep(replace(scene, views=views, points=no_points(4)))
    assert float(actual[3].depth.max()) == float(actual[3].confidence.max()) == 0
    assert float(actual[0].confidence.max()) > 0
    assert "alone" in caplog.text


def test_one_view_is_refused_with_the_alternatives() -> None:
    scene = plane_scene()
    one = replace(scene, views=scene.views[:1], points=no_points(1))
    with pytest.raises(UserError, match=r"two or more .* got 1 .*depth=file"):
        sweep(one)


def test_views_without_any_overlap_are_refused() -> None:
    far = camera((500.0, 0.0, 0.0), (96, 72), 90.0)
    straight = replace(far, viewmat=torch.eye(4, dtype=torch.float64))
    pose = straight.viewmat.clone()
    pose[0, 3] = -500.0
    views = (plane_scene().views[0], view("far", replace(straight, viewmat=pose)))
    with pytest.raises(UserError, match=r"without any overlap .* check scene.near and scene.far"):
        sweep(TrainingSet("apart", views, no_points(2), 3.5, 7.5))
