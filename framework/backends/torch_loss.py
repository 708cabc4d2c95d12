"""The photometric loss of `framework.kernels.losses`, and the gradient of
`framework.kernels.roughness` and `binocular`, in torch, on any device."""

import functools
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import conv2d

from framework.kernels.constants import WHOLE
from framework.types import Render

RADIUS, SIGMA = 5, 1.5  # pixels, of the window
C1, C2 = 0.01**2, 0.03**2
SEEN = 1e-6  # alpha from which a pixel shows something


@dataclass(frozen=True)
class TorchTarget:
    """What the loss needs of a photo, once per view.

    Attributes:
        image: [3, H, W], multiplied by mask [H, W] (None: all counts).
        mean, variance: [3, H, W], its window's statistics.
    """

    image: Tensor
    mask: Tensor | None
    mean: Tensor
    variance: Tensor


def target(image: Tensor, mask: Tensor | None, device: str) -> TorchTarget:
    """Prepare a photo [3, H, W] and its mask [H, W], both on the CPU, for the loss."""
    image = image.detach().to(device)
    if mask is not None:
        mask = mask.detach().to(device)
        image = image * mask
    mean = _blurred(image)
    return TorchTarget(image, mask, mean, _blurred(image * image) - mean * mean)


def photometric_loss(rgb: Tensor, target: TorchTarget, ssim_weight: float) -> Tensor:
    """(1 - w) mean |a - b| + w (1 - mean SSIM) of a render [3, H, W]; a scalar.

    SSIM: Wang et al. 2004, eq. 13, an 11x11 Gaussian window and zero padding, as
    `framework.kernels.losses`."""
    seen = rgb if target.mask is None else rgb * target.mask
    planes = torch.cat([seen, seen * seen, seen * target.image])
    mean, square, product = _blurred(planes).split(len(seen))
    variance, covariance = square - mean * mean, product - mean * target.mean
    above = (2 * mean * target.mean + C1) * (2 * covariance + C2)
    below = (mean**2 + target.mean**2 + C1) * (variance + target.variance + C2)
    l1 = (seen - target.image).abs().mean()
    return (1 - ssim_weight) * l1 + ssim_weight * (1 - (above / below).mean())


def loss_gradient(
    rgb: Tensor, target: TorchTarget, ssim_weight: float, weight: float
) -> tuple[float, Tensor]:
    """`photometric_loss` times `weight`, and its gradient in the render."""
    leaf = rgb.detach().requires_grad_()
    loss = photometric_loss(leaf, target, ssim_weight) * weight
    (gradient,) = torch.autograd.grad(loss, leaf)
    return float(loss.detach()), gradient


def roughness_gradient(alpha: Tensor, depth: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
    """Return the gradients in alpha and depth [H, W].

    Args:
        weights: [2, H, W].
    """
    shows = (alpha > SEEN) & (depth > 0)
    inverse = torch.where(shows, 1 / torch.where(shows, depth, 1.0), 0.0)
    disparity, pull = alpha * inverse, torch.zeros_like(alpha)
    for w, axis in zip(weights, (1, 0), strict=True):
        n = alpha.shape[axis] - 1
        both = shows.narrow(axis, 0, n) & shows.narrow(axis, 1, n)
        step = torch.where(both, disparity.diff(dim=axis).sign() * w.narrow(axis, 0, n), 0.0)
        pull.narrow(axis, 1, n).add_(step)
        pull.narrow(axis, 0, n).sub_(step)
    pull = pull * inverse
    return pull, -pull * disparity


def binocular_gradient(
    alpha: Tensor,
    depth: Tensor,
    beside: Render,
    target: TorchTarget,
    moves: float,
    tolerance: float,
    weight: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return the gradients in alpha and depth [H, W] and in the colours of `beside`."""
    leaves = [t.detach().requires_grad_() for t in (alpha, depth, beside.rgb)]
    disparity = _disparities(*leaves[:2])
    width = disparity.shape[1]
    there = torch.arange(width, device=disparity.device) - moves * disparity
    inside = (there >= 0) & (there <= width - 1)
    left = there.detach().clamp(0, max(width - 2, 0)).floor().long()
    share, right = there - left, (left + 1).clamp(max=width - 1)

    def moved_back(planes: Tensor) -> Tensor:
        near, far = (planes.gather(-1, i.expand_as(planes)) for i in (left, right))
        return near + share * (far - near)

    with torch.no_grad():
        depths = _disparities(beside.alpha, beside.depth)
        shown = (depths > 0).float()
        counts = inside & (disparity > 0) & (moved_back(shown) == 1)
        counts &= (moved_back(depths) - disparity).abs() < tolerance
        if target.mask is not None:
            counts &= target.mask > WHOLE
    loss = weight * ((moved_back(leaves[2]) - target.image).abs() * counts).sum()
    in_alpha, in_depth, in_rgb = torch.autograd.grad(loss, leaves)
    return in_alpha, in_depth, in_rgb


def _disparities(alpha: Tensor, depth: Tensor) -> Tensor:
    """[H, W] inverse expected depth; 0 where nothing is seen."""
    shows = (alpha > SEEN) & (depth > 0)
    return torch.where(shows, alpha / torch.where(shows, depth, 1.0), 0.0)


def _blurred(image: Tensor) -> Tensor:
    """[C, H, W] weighted means over the window of every pixel, rows first."""
    across, down = _taps(image.dtype, str(image.device))
    rows = conv2d(image[:, None], across, padding=(0, RADIUS))
    return conv2d(rows, down, padding=(RADIUS, 0))[:, 0]


@functools.lru_cache(maxsize=4)
def _taps(dtype: torch.dtype, device: str) -> tuple[Tensor, Tensor]:
    """The window along a row, [1, 1, 1, 11], and along a column."""
    offsets = torch.arange(-RADIUS, RADIUS + 1, dtype=torch.float64)
    taps = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    taps = (taps / taps.sum()).to(dtype).to(device)
    return taps.reshape(1, 1, 1, -1), taps.reshape(1, 1, -1, 1)
