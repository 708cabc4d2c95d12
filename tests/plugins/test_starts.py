"""The literature's first Gaussians, `init=patch_growth` and `init=epipolar`, by hand on a wall."""

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from framework.depth.matching.sweep import zncc
from framework.errors import UserError
from framework.geometry import project, unproject
from framework.types import SparsePoints, TrainingSet
from plugins.initialize.epipolar import Line, free_match, sampled
from plugins.initialize.patch_growth import At, PatchGrowth, Photo, confirmed, covariance, ssim
from tests.plugins.fakes import stage


@lru_cache
def seen() -> TrainingSet:
    """The stage's three views, without sparse points."""
    views, _ = stage()
    none = SparsePoints(torch.zeros(0, 3).double(), torch.zeros(0, 3), torch.zeros(0, 3).bool())
    return TrainingSet("stage", views, none, 2.0, 9.0)


def test_ssim_of_two_patches_is_that_of_its_formula() -> None:
    photos = [Photo.of(view, 5) for view in seen().views[:2]]
    rows, columns = np.array([7, 30, 41]), np.array([9, 44, 60])
    there = np.ones(3, bool)
    a, b = (At(photo, rows + i, columns, there) for i, photo in enumerate(photos))
    actual = ssim(a, b, covariance(a, b, 5))
    for k in range(3):
        x, y = (
            at.photo.image[:, at.row[k] - 2 : at.row[k] + 3, at.column[k] - 2 : at.column[k] + 3]
            for at in (a, b)
        )
        each = []
        for one, other in zip(x.reshape(3, -1), y.reshape(3, -1), strict=True):
            (va, cov), (_, vb) = np.cov(one, other, ddof=0)
            ma, mb = one.mean(), other.mean()
            light = (2 * ma * mb + 1e-4) / (ma**2 + mb**2 + 1e-4)
            each.append(light * (2 * cov + 9e-4) / (va + vb + 9e-4))
        assert actual[k] == pytest.approx(np.mean(each), abs=1e-9)
    # the middle of an image of 5 x 5 pixels is what scikit-image calls its SSIM
    x, y = (np.random.default_rng(k).random((5, 5)) for k in (1, 2))
    pair = []
    for image in (x, y):
        view = replace(seen().views[0], image=torch.from_numpy(np.stack([image] * 3)))
        pair.append(At(Photo.of(view, 5), np.array([2]), np.array([2]), np.ones(1, bool)))
    expected = structural_similarity(x, y, win_size=5, data_range=1.0, use_sample_covariance=False)
    assert ssim(*pair, covariance(*pair, 5))[0] == pytest.approx(expected, abs=1e-9)
    assert ssim(*pair, None)[0] >= expected  # the bound that saves the patches


def test_places_on_the_surface_are_confirmed_and_others_are_not() -> None:
    views, depth = stage()
    photos = [Photo.of(view, 5) for view in views]
    on = unproject(depth[0].depth.double(), views[0].camera).reshape(-1, 3).numpy()
    center = views[0].camera.center.numpy()
    kept, colours = confirmed(on, photos, 0.9, 5)
    off, _ = confirmed(center + 0.75 * (on - center), photos, 0.9, 5)
    assert kept.mean() > 2.5 * off.mean() and kept.mean() > 0.2
    error = np.abs(colours - views[0].image.reshape(3, -1).T.numpy())[kept]
    assert np.median(error) < 0.02
    assert not confirmed(center + 100 * np.ones((1, 3)), photos, 0.1, 5)[0].any()  # unseen


def test_growth_adds_its_share_near_to_the_points() -> None:
    training, (_, depth) = seen(), stage()
    plugin = PatchGrowth(rounds=20, per_pixel=0.02, growth=0.5, spread=0.02, similar=0.8)
    first = PatchGrowth(rounds=1, per_pixel=0.02, growth=0.0).build(training, depth, 0, 4)
    grown = plugin.build(training, depth, 1, 4)
    n = round(0.02 * 3 * 80 * 60)
    assert len(first) == n and n < len(grown) <= n + 20 * math.ceil(0.5 * n / 20)
    assert torch.equal(grown.means[:n], first.means)  # what was there stays
    apart = torch.cdist(grown.means[n:], grown.means).sort(1).values[:, 1]
    assert float(apart.median()) < 0.5 and float(grown.opacities[0]) == pytest.approx(0.1)
    other = plugin.build(training, depth, 1, 5)
    assert len(other) != len(grown) or not torch.equal(other.means, grown.means)
    with pytest.raises(UserError, match=r"init.seeds=points.*got 0; use init.seeds=depth"):
        PatchGrowth(seeds="points").build(training, depth, 0, 0)


def test_the_line_is_where_other_depths_are_seen() -> None:
    camera, source = (view.camera for view in seen().views[:2])
    z = np.full((camera.height, camera.width), 5.0)
    line, farther = Line.of(z, camera, source), Line.of(z + 1e-4, camera, source)
    du, dv = (farther.u - line.u) / 1e-4, (farther.v - line.v) / 1e-4
    assert np.allclose(np.hypot(du, dv), 1 / line.dz, rtol=1e-3)
    assert np.allclose(du * line.dz, line.du, atol=1e-3)
    assert np.allclose(dv * line.dz, line.dv, atol=1e-3)
    # the match of a pixel, by another way: through the world
    place = unproject(torch.from_numpy(z), camera)[10, 20]
    uv, _ = project(place[None], source)
    assert (line.u[10, 20], line.v[10, 20]) == pytest.approx(tuple(uv[0].tolist()), abs=1e-9)


def test_a_shifted_image_is_matched_where_it_went() -> None:
    rng = np.random.default_rng(0)
    wide = rng.random((40, 50))
    wide = np.stack([np.convolve(row, np.ones(5) / 5, "same") for row in wide])
    image, other = wide[5:35, 5:45], wide[4:34, 7:47]  # what is at (x, y) is at (x - 2, y + 1)
    y, x = np.mgrid[:30, :40] + 0.5
    (dx, dy), alike = free_match(image, other, x - 1.0, y, 3)
    inner = np.s_[6:-6, 6:-6]
    assert np.abs(dx[inner] + 1).max() < 0.2 and np.abs(dy[inner] - 1).max() < 0.2
    assert alike[inner].min() > 0.99
    assert np.allclose(sampled(image, x, y), image, atol=1e-4)
    a, b = image[:7, :7], other[:7, :7]
    middle = zncc(a, b, 3)[3, 3]
    cov = np.cov(a.reshape(-1), b.reshape(-1), ddof=0) + 2e-5 * np.eye(2)
    assert middle == pytest.approx(cov[0, 1] / math.sqrt(cov[0, 0] * cov[1, 1]), abs=1e-6)
