"""The co-adaptation score and AVGE by hand."""

import numpy as np
import pytest
import torch
from torch import Tensor

from framework.metrics.coadaptation import RENDERS, average_error, coadaptation, with_coadaptation
from framework.metrics.values import Missing, ViewMetrics
from framework.types import Camera, Render


def measured(lpips: float | Missing) -> ViewMetrics:
    return ViewMetrics("a", (), 20.0, 0.75, 0.1, lpips, lpips, 0.01, {"edges": 1.0})


CAMERA = Camera(torch.eye(4), torch.eye(3), 2, 1)


def test_the_variance_counts_where_all_renders_show_something() -> None:
    """The left pixel is the share that is kept; the right one is seen in all but the last."""
    inputs: list[Tensor] = []

    def render(camera: Camera, factors: Tensor) -> Render:
        inputs.append(factors)
        rgb = torch.zeros(3, 1, 2)
        rgb[:, 0, 0], rgb[:, 0, 1] = factors.mean(), len(inputs)
        alpha = torch.tensor([[1.0, 0.9 if len(inputs) < RENDERS else 0.5]])
        return Render(rgb, alpha, alpha, torch.ones(1))

    actual = coadaptation(render, 50, CAMERA, np.random.default_rng(0))
    shares = [float(factors.mean()) for factors in inputs]
    assert len(shares) == 5 and 0.3 < np.mean(shares) < 0.7
    assert actual == pytest.approx(np.var(shares), rel=1e-5)
    assert all(set(factors.tolist()) == {0.0, 1.0} for factors in inputs)


def test_the_mean_of_errors() -> None:
    assert average_error(20.0, 0.75, 0.4) == pytest.approx((0.01 * 0.5 * 0.4) ** (1 / 3))


def test_every_view_gets_its_score() -> None:
    drawn: list[Tensor] = []

    def render(camera: Camera, factors: Tensor) -> Render:
        drawn.append(factors)
        image = torch.full((3, 1, 2), float(factors.mean()))
        alpha = torch.ones(1, 2) if len(drawn) <= RENDERS else torch.zeros(1, 2)
        return Render(image, alpha, alpha, torch.ones(1))

    views = [measured(0.4), measured(0.4)]
    rng = np.random.default_rng(0)
    seen, empty = with_coadaptation(views, render, 40, [CAMERA, CAMERA], rng)
    shares = [float(factors.mean()) for factors in drawn[:RENDERS]]
    assert seen.value("coadaptation") == pytest.approx(np.var(shares), rel=1e-4)
    assert isinstance(empty.value("coadaptation"), Missing)
