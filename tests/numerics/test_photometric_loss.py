"""The L1 + SSIM kernel against a float64 torch implementation: value and gradient."""

import pytest
import torch
from torch import Tensor
from torch.nn.functional import conv2d

from framework.compute.rng import stream
from framework.kernels.losses import Target, photometric_loss

SIZES = ((40, 30), (64, 48), (33, 21), (16, 11), (9, 5), (1, 1), (101, 17), (23, 130), (17, 67))


def loss_reference(rgb: Tensor, image: Tensor, mask: Tensor | None, ssim_weight: float) -> Tensor:
    """(1 - w) mean |a - b| + w (1 - mean SSIM); images [3, H, W], mask [H, W] multiplies both.

    SSIM (Wang et al. 2004, eq. 13) with an 11x11 Gaussian window, sigma 1.5, zero padding,
    variances as E[x^2] - mu^2 and constants 0.01^2, 0.03^2.
    """
    a, b = (rgb, image) if mask is None else (rgb * mask, image * mask)
    taps = torch.exp(-((torch.arange(11, dtype=rgb.dtype) - 5) ** 2) / (2 * 1.5**2))
    taps = taps / taps.sum()
    window = torch.outer(taps, taps).expand(3, 1, 11, 11)

    def blur(x: Tensor) -> Tensor:
        return conv2d(x[None], window, padding=5, groups=3)[0]

    ma, mb = blur(a), blur(b)
    va, vb, covariance = blur(a * a) - ma**2, blur(b * b) - mb**2, blur(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    ssim = (2 * ma * mb + c1) * (2 * covariance + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))
    return (1 - ssim_weight) * (a - b).abs().mean() + ssim_weight * (1 - ssim.mean())


def _images(width: int, height: int) -> tuple[Tensor, Tensor, Tensor]:
    """Render, target (correlated with it) and a soft mask; float32."""
    rng = stream(width * 1000 + height, "test-loss")
    target = torch.from_numpy(rng.random((3, height, width)))
    render = target + 0.2 * torch.from_numpy(rng.standard_normal((3, height, width)))
    mask = torch.from_numpy(rng.random((height, width)) * (rng.random((height, width)) < 0.8))
    return render.float(), target.float(), mask.float()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("ssim_weight", [0.0, 0.2, 1.0])
def test_value_and_gradient(size: tuple[int, int], masked: bool, ssim_weight: float) -> None:
    render, image, soft = _images(*size)
    mask = soft if masked else None
    ours, theirs = render.clone().requires_grad_(), render.double().requires_grad_()
    kernel = photometric_loss(ours, Target.of(image, mask), ssim_weight)
    exact = loss_reference(
        theirs, image.double(), None if mask is None else mask.double(), ssim_weight
    )
    assert abs(float(kernel.detach()) - float(exact.detach())) < 2e-6
    (3 * kernel).backward()
    (3 * exact).backward()
    assert ours.grad is not None and theirs.grad is not None
    error = (ours.grad - theirs.grad).norm()
    assert error <= 1e-4 * theirs.grad.norm(), f"{error / theirs.grad.norm():.1e}"


def test_outside_the_mask_nothing_counts() -> None:
    render, image, _ = _images(40, 30)
    mask = torch.zeros(30, 40)
    mask[:, :20] = 1
    other = render.clone()
    other[:, :, 20:] = 0.123
    losses = [photometric_loss(x, Target.of(image, mask), 0.2) for x in (render, other)]
    assert torch.equal(*losses)
    leaf = render.clone().requires_grad_()
    photometric_loss(leaf, Target.of(image, mask), 0.2).backward()
    assert leaf.grad is not None and not leaf.grad[:, :, 20:].any()
