"""Evidence decides: the terms against their definitions, and what is left of known scenes: a plane,
a constant colour, noise."""

import logging
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from framework.compute.rng import stream
from framework.options import TrainerOptions
from framework.records.progress import Silent
from framework.run.plane import textured_plane
from framework.toolbox.rounds import training_information
from framework.train.trainer import Evaluate, Plugins, Trained, Trainer
from framework.types import TrainingSet
from plugins.capacity.evidence import FEWEST, HANDFUL, description_cost, residual_noise
from tests.capacity.population import watched
from tests.plugins.fakes import wall_of_gaussians


def test_the_noise_is_that_of_the_residuals_and_its_channels() -> None:
    ctx = watched()
    renders = [ctx.render(view.camera).rgb for view in ctx.views]
    draws = stream(0, "noise").normal(0, 0.1, (3, *renders[0].shape)).astype(np.float32)
    for shared, expected in ((False, 1.0), (True, 3.0)):
        noise = [torch.from_numpy(d[:1].repeat(3, 0) if shared else d) for d in draws]
        views = [
            replace(view, image=render + extra)
            for view, render, extra in zip(ctx.views, renders, noise, strict=True)
        ]
        variance, values, channels = residual_noise(replace(ctx, views=tuple(views)))
        assert variance == pytest.approx(0.01, rel=0.05)
        assert channels == pytest.approx(expected, rel=0.05)
        assert values == 3 * renders[0].numel()


def test_masked_pixels_do_not_count_and_eight_bits_are_the_floor() -> None:
    ctx = watched()
    half = torch.zeros(ctx.views[0].image.shape[1:])
    half[:, ::2] = 1
    perfect = [replace(v, image=ctx.render(v.camera).rgb, mask=half) for v in ctx.views]
    spoiled = [replace(v, image=torch.where(half > 0, v.image, 0.9)) for v in perfect]
    for views in (perfect, spoiled):
        variance, values, _ = residual_noise(replace(ctx, views=tuple(views)))
        assert variance == pytest.approx((1 / 255) ** 2 / 12)
        assert values == 3 * 3 * float(half.sum())


def test_the_cost_is_half_the_log_determinant_and_grows_with_knowledge() -> None:
    subject = wall_of_gaussians(30)
    reference = training_information(watched(subject)).total
    little, much = (description_cost(subject, reference, noise) for noise in (1e-2, 1e-4))
    assert (little >= math.log(2)).all() and (much >= little).all() and much.max() > 5
    assert np.allclose(description_cost(subject, reference, 1e12), math.log(2))
    bands = replace(subject, shN=torch.randn(30, 3, 3, generator=torch.Generator().manual_seed(0)))
    assert (description_cost(bands, reference, 1e-4) >= much).all()
    assert description_cost(bands, reference, 1e-4).max() > much.max() + 5


def trained(
    training: TrainingSet, steps: int, evaluate: Evaluate | None = None, **options: float
) -> Trained:
    """A short training on the plane's cameras, from 1,200 Gaussians before it."""
    _, depth, few = textured_plane(0)
    draws = torch.from_numpy(stream(0, "many").uniform(-0.1, 0.1, (6, len(few), 3))).float()
    start = replace(
        few,
        **{name: tensor.repeat(6, *[1] * (tensor.dim() - 1)) for name, tensor in few.items()}
        | {"means": (few.means + draws).reshape(-1, 3)},
    )
    idle, chosen = {"name": "none"}, {"name": "evidence", **options}
    choices = {"augment": idle, "reg": idle, "capacity": chosen}
    plugins = Plugins.of(choices)
    trainer = TrainerOptions(steps=steps, evaluations=1)
    return Trainer(training, depth, start, trainer, plugins, 0, Silent(), evaluate).run()


def with_images(paint) -> TrainingSet:  # type: ignore[no-untyped-def]
    """The plane's training set with other images: view index, [3, H, W] image -> image."""
    training = textured_plane(0)[0]
    views = tuple(
        replace(view, image=paint(i, view.image)) for i, view in enumerate(training.views)
    )
    return replace(training, views=views)


def test_a_scene_of_one_colour_ends_with_a_handful_and_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.WARNING, "plugins"):
        result = trained(with_images(lambda _, image: torch.full_like(image, 0.5)), 300)
    assert FEWEST <= len(result.gaussians) <= HANDFUL
    (message,) = [record.getMessage() for record in caplog.records]
    assert "hardly any Gaussian is worth its cost" in message and "\n" not in message


def test_the_size_follows_the_content() -> None:
    """A smooth plane needs fewer than a detailed one; noise that no two views share gets no more
    than the start."""

    def smooth(_: int, image: torch.Tensor) -> torch.Tensor:
        column = torch.linspace(0.2, 0.8, image.shape[2])
        return column.expand_as(image).contiguous()

    def noise(i: int, image: torch.Tensor) -> torch.Tensor:
        return torch.from_numpy(stream(i, "picture").random(tuple(image.shape))).float()

    sizes = [len(trained(with_images(p), 60).gaussians) for p in (smooth, lambda _, x: x, noise)]
    assert sizes[0] < 200 and sizes[0] < sizes[1] and max(sizes) < 1200
