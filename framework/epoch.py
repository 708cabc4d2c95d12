"""The views of an epoch: their order, and each ready for a step at the resolution of the moment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from framework.losses import Target
from framework.rng import stream
from framework.types import View

PSEUDO = "pseudo"  # the tag the trainer gives to what an augmenter returns


def ordered(
    real: Sequence[View], pseudo: Sequence[View], seed: int, epoch: int
) -> list[tuple[View, ...]]:
    """The steps of an epoch: a real view each, and after it the pseudo views that join its step.

    The order of the real ones depends on (seed, epoch) alone; a pseudo view joins a step by a draw
    of its own. So all methods of a seed see the same real view at every step.
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
    """A view at the resolution that is trained now, with what the loss needs of it."""

    view: View
    target: Target


class Items:
    """Items of real views are kept at their present resolution, those of pseudo views made anew:
    they live for an epoch."""

    def __init__(self) -> None:
        self._kept: dict[str, tuple[int, Item]] = {}

    def get(self, view: View, factor: int) -> Item:
        """`view` box-downsampled by `factor`."""
        if PSEUDO in view.tags:
            return _item(view, factor)
        kept = self._kept.get(view.name)
        if kept is None or kept[0] != factor:
            kept = self._kept[view.name] = factor, _item(view, factor)
        return kept[1]


def _item(view: View, factor: int) -> Item:
    """A coarse pixel is valid if all the pixels it covers are."""
    if factor > 1:
        mask = None
        if view.mask is not None:
            mask = (box_mean(view.mask[None], factor)[0] > 0.999).float()
        camera, image = view.camera.scaled(factor), box_mean(view.image, factor)
        view = replace(view, camera=camera, image=image, mask=mask, depth=None)
    return Item(view, Target.of(view.image, view.mask))


def box_mean(image: Tensor, factor: int) -> Tensor:
    """Mean over factor x factor boxes of [C, H, W]; a last, incomplete row or column is cut."""
    channels, height, width = image.shape
    h, w = height // factor, width // factor
    boxes = image[:, : h * factor, : w * factor].numpy().reshape(channels, h, factor, w, factor)
    return torch.from_numpy(boxes.mean(axis=(2, 4), dtype=np.float64).astype(np.float32))
