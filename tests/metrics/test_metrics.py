"""The metrics against scikit-image, closed forms and the FLIP package, in the stated protocol."""

import math

import flip_evaluator
import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio
from torch import Tensor

from framework.compute.rng import stream
from framework.metrics import evaluate as metrics
from framework.metrics.evaluate import quantise
from framework.metrics.flip import error_map
from framework.metrics.values import Missing, ViewMetrics
from framework.types import Camera, View

GREEN, BLUE = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def image(purpose: str, height: int = 40, width: int = 53) -> Tensor:
    pixels = stream(0, purpose).integers(0, 256, (3, height, width))
    return torch.from_numpy(pixels).float() / 255.0


def similar(truth: Tensor, amount: float = 0.1) -> Tensor:
    noise = torch.from_numpy(stream(1, "noise").standard_normal(tuple(truth.shape))).float()
    return truth + amount * noise


def on_disk(planar: Tensor) -> np.ndarray:
    return metrics.quantise(planar) / 255.0


def view_of(truth: Tensor, mask: Tensor | None = None) -> View:
    height, width = truth.shape[1:]
    camera = Camera(torch.eye(4), torch.eye(3), width, height)
    return View("a", camera, truth, mask=mask, tags=("interpolating",))


def of(render: Tensor, truth: Tensor, mask: Tensor | None = None) -> ViewMetrics:
    return metrics.evaluate(lambda _: render, [view_of(truth, mask)])[0][0]


def test_psnr_equals_scikit_image() -> None:
    truth = image("truth")
    render = similar(truth)
    x, y = on_disk(render), on_disk(truth)
    assert metrics.psnr(render, truth) == pytest.approx(
        peak_signal_noise_ratio(y, x, data_range=1.0), abs=1e-9
    )


def test_ssim_equals_its_definition_over_windows_inside_the_image() -> None:
    truth = image("truth", 24, 19)
    render = similar(truth, 0.2)
    offsets = np.arange(11) - 5.0
    window = np.exp(-(offsets**2) / (2 * 1.5**2))
    weights = np.outer(window, window) / window.sum() ** 2
    x, y = on_disk(render), on_disk(truth)
    values = []
    for row in range(24 - 10):
        for column in range(19 - 10):
            a, b = (p[row : row + 11, column : column + 11] for p in (x, y))
            w = weights[..., None]
            ma, mb = (w * a).sum((0, 1)), (w * b).sum((0, 1))
            va, vb = (w * a * a).sum((0, 1)) - ma**2, (w * b * b).sum((0, 1)) - mb**2
            cov = (w * a * b).sum((0, 1)) - ma * mb
            top = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4)
            values.append(top / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4)))
    assert of(render, truth).ssim == pytest.approx(np.mean(values), abs=1e-6)


def test_flip_is_that_of_the_authors_package() -> None:
    """On images alike, unlike, of one colour, and smaller than a filter."""
    truth, rng = image("truth"), stream(0, "flip")
    noise = [torch.from_numpy(rng.random((3, 40, 50))) for _ in range(2)]
    green, blue = (torch.zeros(3, 5, 4) + torch.tensor(c)[:, None, None] for c in (GREEN, BLUE))
    for a, b in ((similar(truth), truth), noise, (green, blue), (0 * truth, 0 * truth + 1)):
        pair = (on_disk(b).astype(np.float32), on_disk(a).astype(np.float32))
        expected, _, _ = flip_evaluator.evaluate(*pair, "LDR", applyMagma=False)
        actual = error_map(quantise(b), quantise(a))
        np.testing.assert_allclose(actual, np.squeeze(expected), atol=1e-4)
        assert of(a, b).flip == pytest.approx(float(np.mean(expected)), abs=1e-5)
    assert of(truth, truth).flip == 0.0
    assert of(green, blue).flip == pytest.approx(1.0, abs=1e-6)


def test_masked_metrics_are_those_of_the_dtu_protocol() -> None:
    """PSNR over the object's pixels alone; the others of both images laid on white."""
    truth = image("truth")
    render = similar(truth)
    mask = torch.zeros(40, 53)
    mask[8:33, 11:40] = 1
    white = [torch.where(mask > 0, picture, 1.0) for picture in (render, truth)]
    measured = of(render, truth, mask)
    assert measured.ssim == of(*white).ssim
    assert measured.flip == of(*white).flip
    inside = [torch.from_numpy(on_disk(p).transpose(2, 0, 1))[:, mask > 0] for p in (render, truth)]
    mse = float(((inside[0] - inside[1]) ** 2).mean())
    assert measured.psnr == pytest.approx(-10 * math.log10(mse))
    whole = metrics.psnr(*white)
    assert isinstance(measured.psnr, float) and isinstance(whole, float)
    assert whole > measured.psnr  # white pixels agree; they must not raise the PSNR
    assert isinstance(metrics.psnr(render, truth, 0 * mask), Missing)
