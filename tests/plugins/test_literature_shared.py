"""What several of the literature's plugins share, against numbers worked by hand, or an
independent few lines in float64."""

import math
from dataclasses import replace

import pytest
import torch

from framework.compute.rng import stream
from framework.toolbox.elsewhere import bilinear, known_depth, seen_through, unseen_camera
from tests.plugins.at_work import true_depth
from tests.plugins.fakes import context, stage


def test_known_depth_is_that_of_the_view_at_its_size() -> None:
    ctx, view, depth = true_depth()
    actual, valid = known_depth(ctx, view) or (depth, depth)
    assert torch.equal(actual, depth) and valid.all()
    small = replace(view, camera=view.camera.scaled(2), image=view.image[:, ::2, ::2])
    halved, valid = known_depth(ctx, small) or (depth, depth)
    assert halved.shape == small.image.shape[1:] and valid.all()
    assert torch.allclose(halved[0, 0], depth[:2, :2].mean())
    assert known_depth(ctx, replace(view, name="pseudo-1")) is None
    gone = replace(ctx.depth[0], confidence=torch.zeros_like(depth))
    assert not (known_depth(replace(ctx, depth=(gone, *ctx.depth[1:])), view) or (0, depth))[
        1
    ].any()


def test_an_unseen_camera_is_between_two_neighbours() -> None:
    ctx = context()
    cameras = [view.camera for view in ctx.views]
    for seed in range(8):
        camera = unseen_camera(ctx, stream(seed, "test"), cameras[0].scaled(2))
        a, b = min(
            ((a, b) for a in cameras for b in cameras if a is not b),
            key=lambda p: (
                float((p[0].center - camera.center).norm() + (p[1].center - camera.center).norm())
                - float((p[0].center - p[1].center).norm())
            ),
        )
        through = (a.center - camera.center).norm() + (camera.center - b.center).norm()
        assert float(through) == pytest.approx(float((a.center - b.center).norm()))
        assert (camera.width, camera.height) == (40, 30)
        R = camera.viewmat[:3, :3]
        assert torch.allclose(R @ R.T, torch.eye(3, dtype=torch.float64), atol=1e-9)
    alone = replace(ctx, views=ctx.views[:1])
    camera = unseen_camera(alone, stream(1, "test"), cameras[0])
    assert 0 < float((camera.center - cameras[0].center).norm()) < 0.2 * ctx.extent


def test_seen_through_exact_depth_is_what_is_seen() -> None:
    views, depth = stage()
    actual, valid, there = seen_through(
        views[1].image, depth[0].depth, views[0].camera, views[1].camera
    )
    error = (actual - views[0].image).abs().mean(0)[valid]
    assert valid.float().mean() > 0.75 and float(error.median()) < 0.02
    assert (there[valid] > 0).all()
    # through itself nothing changes, to the last pixel
    same, valid, there = seen_through(
        views[0].image, depth[0].depth, views[0].camera, views[0].camera
    )
    assert torch.allclose(same, views[0].image, atol=1e-3) and valid[1:-1, 1:-1].all()
    assert torch.allclose(there, depth[0].depth, atol=1e-4)


@pytest.mark.parametrize("size", [(5, 7), (1, 4), (3, 1)])
def test_pictures_are_sampled_as_pytorch_samples_them(size: tuple[int, int]) -> None:
    """Values and gradients, on the border and beyond it too; but for the bits of the sums."""
    draws = stream(0, "sampled")
    image = torch.from_numpy(draws.random((2, *size))).float().requires_grad_()
    u = torch.from_numpy(draws.uniform(-1, size[1] + 1, (6, 8))).float().requires_grad_()
    v = torch.from_numpy(draws.uniform(-1, size[0] + 1, (6, 8))).float().requires_grad_()
    grid = torch.stack([2 * u / size[1] - 1, 2 * v / size[0] - 1], -1)
    theirs = torch.nn.functional.grid_sample(
        image[None], grid[None], padding_mode="border", align_corners=False
    )[0]
    ours, pull = bilinear(image, u, v), torch.ones_like(theirs)
    assert torch.allclose(ours, theirs, atol=1e-5)
    for a, b in zip(
        torch.autograd.grad(ours, [image, u, v], pull),
        torch.autograd.grad(theirs, [image, u, v], pull),
        strict=True,
    ):
        assert torch.allclose(a, b, atol=1e-4)
    broken = torch.tensor([[math.nan, math.inf, 1.0]])
    assert bilinear(image.detach(), broken, broken)[0, 0].isnan().tolist() == [True, False, False]
