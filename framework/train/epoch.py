"""The views of an epoch: their order, and their preparation at the current resolution."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer
from framework.compute.rng import stream
from framework.train.depth_priors import Beside, DepthSmoothness
from framework.types import View


def ordered(
    real: Sequence[View], pseudo: Sequence[View], seed: int, epoch: int
) -> list[tuple[View, ...]]:
    """Return the steps of an epoch: each has one real view and the pseudo views of its step.

    The order of the real views depends on (seed, epoch) alone, and pseudo views are assigned by a
    separate draw. So all methods of a seed see the same real view at every step.
    """
    order = stream(seed, "epoch", epoch).permutation(len(real))
    steps: list[tuple[View, ...]] = [(real[i],) for i in order]
    rng = stream(seed, "epoch/pseudo", epoch)
    for view in pseudo:
        joined = int(rng.integers(len(steps)))
        steps[joined] = (*steps[joined], view)
    return steps


@dataclass(frozen=True)
class Item:
    """A view at the current resolution, on the CPU, with the inputs of its loss.

    Attributes:
        target: for the photometric loss, on the rasterizer's device.
        smoothing: weights of the depth smoothness.
        beside: the second camera of this step.
    """

    view: View
    target: Any
    smoothing: Any = None
    beside: Beside | None = None


class Items:
    """Views at their present resolution, kept while they are trained on: a pseudo view may live
    for some epochs.

    Args:
        covered: a pseudo view's loss is the mean over the pixels in its mask, which is that over
            the frame divided by the share that they cover (outside, loss and SSIM's error are 0).
        smoothness: of the depth behind real views.
    """

    def __init__(
        self,
        covered: bool = False,
        rasterizer: Rasterizer = NUMBA,
        smoothness: DepthSmoothness | None = None,
    ) -> None:
        self._covered, self._rasterizer, self._smoothness = covered, rasterizer, smoothness
        self._kept: dict[tuple[bool, str], tuple[tuple[object, ...], View, Item]] = {}

    def begin(self, pseudo: Sequence[View]) -> None:
        """An epoch with these pseudo views: others are forgotten."""
        names = {view.name for view in pseudo}
        self._kept = {k: kept for k, kept in self._kept.items() if not k[0] or k[1] in names}

    def get(self, view: View, factor: int) -> Item:
        """`view` box-downsampled by `factor`."""
        key = view.pseudo, view.name
        marks = (factor, *_marks(view)) if view.pseudo else (factor,)  # photos stay as they are
        kept = self._kept.get(key)
        if kept is None or kept[0] != marks:
            # the view stays with them, as another could get the identity of one that went
            kept = self._kept[key] = marks, view, self._made(view, factor)
        return kept[2]

    def _made(self, view: View, factor: int) -> Item:
        view, device, smoothing = _smaller_view(view, factor), self._rasterizer.device, None
        if self._covered and view.pseudo:
            view = _over_covered(view)
        target = self._rasterizer.losses().target(view.image, view.mask, device)
        if self._smoothness is not None and not view.pseudo:
            smoothing = self._smoothness.weights(view).to(device)
        return Item(view, target, smoothing)


def _marks(view: View) -> tuple[object, ...]:
    """Values that change when a pseudo view changes."""
    tensors = [tensor for tensor in (view.image, view.mask, view.depth) if tensor is not None]
    # torch does not count writes into inference tensors: always taken as changed
    written = [object() if t.is_inference() else (id(t), t._version) for t in tensors]
    return len(tensors), id(view.camera), view.weight, view.tags, view.lens, *written


def _smaller_view(view: View, factor: int) -> View:
    if factor == 1:
        return view
    image, mask = _smaller(view, factor)
    camera = view.camera.scaled(factor)
    return replace(view, camera=camera, image=image, mask=mask, depth=None)


def _over_covered(view: View) -> View:
    """The view with a weight that makes its loss the mean over its mask."""
    share = 0.0 if view.mask is None else float(np.mean(view.mask.numpy(), dtype=np.float64))
    return view if share == 0 else replace(view, weight=view.weight / share)


def _smaller(view: View, factor: int) -> tuple[Tensor, Tensor | None]:
    """Image and mask.

    A coarse pixel of a photo is valid if all the pixels it covers are valid. Pseudo views have many
    small holes: there half of the pixels must be valid, and the pixel is their mean.
    """
    if view.mask is None:
        return box_mean(view.image, factor), None
    share = box_mean(view.mask[None], factor)
    if not view.pseudo:
        return box_mean(view.image, factor), (share[0] > 0.999).float()
    mask = (share[0] >= 0.5).float()
    return mask * box_mean(view.image * view.mask, factor) / share.clamp(min=0.5), mask


def box_mean(image: Tensor, factor: int) -> Tensor:
    """Mean over factor x factor boxes of [C, H, W]; a last, incomplete row or column is cut."""
    _, height, width = image.shape
    pixels = image.numpy()[:, : height // factor * factor, : width // factor * factor]
    rows = _sums(pixels, 1, factor)  # in turn: an eighth of the time of a mean over both axes
    means = _sums(rows, 2, factor) / factor**2
    return torch.from_numpy(means.astype(np.float32))


def _sums(values: np.ndarray, axis: int, factor: int) -> np.ndarray:
    """Sums of every `factor` neighbours along `axis`, in float64."""
    before = (slice(None),) * axis
    total = values[(*before, slice(0, None, factor))].astype(np.float64)
    for first in range(1, factor):
        total += values[(*before, slice(first, None, factor))]
    return total
