"""The absolute gradient on the screen against autograd, pixel by pixel, and who measures it."""

from typing import Any

import pytest
import torch

from framework.kernels import rasterize, render_gradient
from framework.run.plane import textured_plane
from framework.types import Camera
from tests.plugins.fakes import stage, wall_of_gaussians


def small_camera() -> Camera:
    """20 x 18 pixels: two tiles wide and high, both cut off."""
    camera = stage()[0][0].camera
    K = camera.K.clone()
    K[:2] *= 20 / camera.width
    return Camera(camera.viewmat, K, 20, 18)


def test_it_sums_what_every_pixel_pulls() -> None:
    gaussians, camera = wall_of_gaussians(40), small_camera()
    gaussians = gaussians.replace(log_scales=gaussians.log_scales + 1.2)
    background, factors = torch.tensor([0.2, 0.5, 0.1]), torch.linspace(0.3, 1.0, 40)
    in_rgb = torch.zeros(3, 18, 20)  # a pixel takes a render and its gradient: every fourth one
    in_rgb[:, ::2, ::2] = torch.randn(3, 9, 10, generator=torch.Generator().manual_seed(1))
    how: dict[str, Any] = {"background": background, "opacity_factors": factors}
    both = render_gradient(gaussians, camera, lambda rgb: in_rgb.numpy(), absolute=True, **how)
    alone = render_gradient(gaussians, camera, lambda rgb: in_rgb.numpy(), **how)
    actual = both.absolute
    assert actual is not None and alone.absolute is None
    assert torch.equal(both.pull_back()[1], alone.pull_back()[1])
    expected, signed = torch.zeros(40, 2), torch.zeros(40, 2)
    for y in range(0, 18, 2):
        for x in range(0, 20, 2):
            offset = torch.zeros(40, 2, requires_grad=True)
            image = rasterize(gaussians, camera, means2d_offset=offset, **how).rgb
            loss = (image[:, y, x] * in_rgb[:, y, x]).sum()
            (gradient,) = torch.autograd.grad(loss, offset)
            expected += gradient.abs()
            signed += gradient
    assert float(expected.max()) > 0.1
    assert torch.allclose(actual, expected, rtol=1e-3, atol=1e-5)
    assert float((expected - signed.abs()).max()) > 0.05  # pulls do cancel here


@pytest.mark.parametrize("penalty", ["none", "opacity_noise"])
def test_a_capacity_that_asks_sees_it_and_others_do_not(penalty: str) -> None:
    from framework.options import TrainerOptions
    from framework.plugin import StepStats
    from framework.records.progress import Silent
    from framework.train.trainer import Plugins, Trainer

    training, depth, gaussians = textured_plane(0)
    seen: dict[bool, list[StepStats]] = {False: [], True: []}
    for asked, message in seen.items():
        names = {"augment": {"name": "none"}, "reg": {"name": penalty}}
        names["capacity"] = {"name": "adc", "absolute": asked} | {"every": 1000}
        plugins = Plugins.of(names)
        options = TrainerOptions(steps=3, evaluations=1, ssim_weight=0.2)
        trainer = Trainer(training, depth, gaussians, options, plugins, 0, Silent(), warns=False)
        edit = trainer._edit
        trainer._edit = lambda s, edit=edit, message=message: (message.append(s), edit(s))[1]  # type: ignore[method-assign,misc]
        trainer.run()
    assert all(stats.absolute is None for stats in seen[False])
    for plain, stats in zip(seen[False], seen[True], strict=True):
        assert stats.absolute is not None and torch.equal(plain.means2d_grad, stats.means2d_grad)
        assert (stats.absolute + 1e-6 >= stats.means2d_grad.abs()).all()
