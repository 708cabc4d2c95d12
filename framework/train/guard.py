"""Detects divergence: the training ends at the first step whose loss, gradients, moments or
parameters are not finite, with a message that names them."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from framework.errors import UserError
from framework.train.optimizer import AdamState
from framework.types import Gaussians

ADVICE = "lower trainer.lr_scale"
SLOPES = (
    f"{ADVICE}, or repair a plugin's loss term whose derivative is not finite, as that of a square"
    " root at 0"
)


class Diverged(UserError):
    """A training that cannot continue.

    Args:
        state: values for inspection that `framework.files.tree` can store.
    """

    kind = "diverged"

    def __init__(self, message: str, state: Mapping[str, Any]) -> None:
        super().__init__(message)
        self.state = dict(state)


def check_loss(loss: float, where: str, gaussians: Gaussians) -> float:
    """`loss` if it is finite. Raises Diverged."""
    if not math.isfinite(loss):
        raise Diverged(
            f"{where}: expected a finite loss, got {loss}; {ADVICE}",
            {"where": where, "loss": loss, "gaussians": gaussians.detach()},
        )
    return loss


def check_appended(appended: Gaussians, where: str) -> None:
    """Raises Diverged unless what the capacity plugin adds is finite."""
    for name, tensor in appended.items():
        if _broken(tensor):
            raise Diverged(
                f"{where}: expected the capacity plugin to add finite Gaussians, got NaN or"
                f" infinity in '{name}' of {_broken(tensor)}; choose another capacity",
                {"where": where, "gaussians": appended},
            )


def diverged(names: tuple[str, ...], where: str, gaussians: Gaussians, adam: AdamState) -> Diverged:
    """The error of a step that left the tensors `names` (parameters or moments) not finite.

    Args:
        gaussians, adam: state after the step. The moments show the gradient: an infinite one makes
            the first moment infinite, NaN makes the second NaN.
    """
    name = names[0]
    first, second = getattr(adam.first, name), getattr(adam.second, name)
    steep = _rows(torch.isinf(first) | torch.isnan(second))
    advice = SLOPES if steep > 0 else ADVICE
    if steep > 0:
        what = f"finite gradients, got NaN or infinity for {steep} Gaussians in '{name}'"
    else:
        count = _broken(getattr(gaussians, name))
        what = (
            f"finite parameters, got NaN or infinity for {count} Gaussians in '{name}'"
            if count
            else f"gradients below 1e19, got larger ones in '{name}', whose squares overflow"
        )
    state = {"where": where, "gaussians": gaussians, "adam": adam}
    return Diverged(f"{where}: expected {what}; {advice}", state)


def _broken(tensor: Tensor) -> int:
    """The number of rows with a value that is not finite."""
    return _rows(~torch.isfinite(tensor.detach()))


def _rows(marked: Tensor) -> int:
    """How many have a mark; also of no Gaussian at all."""
    return int(marked[:, None].flatten(1).any(dim=1).sum())
