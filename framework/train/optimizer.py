"""What every Adam of a training has, whatever computes its step: the moments, and how they follow
a set of Gaussians that changes."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from framework.backends import RenderGradient
from framework.types import Gaussians, edited

Grads = Mapping[str, Tensor | None] | Gaussians  # by name of a parameter
Rates = Mapping[str, float]
Names = tuple[str, ...]


@dataclass(frozen=True)
class AdamState:
    """State of Adam.

    Attributes:
        first, second: the moments, shaped like the parameters, float32.
        steps: finished updates of each tensor, in the order of `Gaussians.items()`.
    """

    first: Gaussians
    second: Gaussians
    steps: tuple[int, ...]


class Optimizer(ABC):
    """Adam for a set of Gaussians whose number may change; its moments are where these are.

    All tensors are float32 of shape like the `gaussians` given at construction.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self._first, self._second = gaussians.map(_none_yet), gaussians.map(_none_yet)
        self._steps = dict.fromkeys((name for name, _ in gaussians.items()), 0)

    @abstractmethod
    def step(self, params: Gaussians, grads: Grads, rates: Rates, decay: float = 1.0) -> Names:
        """Update `params` in place, then multiply the activated opacities by `decay` in (0, 1].
        Returns the names of tensors with non-finite values or second moments, which every
        non-finite gradient causes.

        Args:
            grads: by tensor name, shaped like the parameters; a tensor without one (None or
                missing) is left alone, its moments too, as in torch.
            rates: learning rate of every tensor with a gradient, in the tensor's own units.

        Raises:
            ValueError: when shapes differ.
        """

    @abstractmethod
    def step_from(
        self, gradient: RenderGradient, rates: Rates, decay: float = 1.0
    ) -> tuple[Names, Tensor]:
        """`step` of `gradient.gaussians`, in place, by what `gradient.pull_back` returns: the same
        bits. Uses `gradient` up.

        Returns:
            What `step` does and, as `pull_back`, the gradient in the projected means [N, 2].
        """

    def edit(self, keep: Tensor | None, bands: Tensor | None, append: Gaussians | None) -> None:
        """Follow a change of the set, see `types.edited`; the moments of new ones are zero."""
        new = None if append is None else append.map(_none_yet)
        self._first = edited(self._first, keep, bands, new)
        self._second = edited(self._second, keep, bands, new)

    def zero(self, name: str) -> None:
        """Forget the moments of one tensor. Its step count stays (as 3DGS does at an opacity
        reset), hence the bias correction is not repeated."""
        getattr(self._first, name).zero_()
        getattr(self._second, name).zero_()

    def state(self) -> AdamState:
        """Return the state on the CPU. It shares the optimizer's tensors there, which the next step
        changes."""
        return AdamState(self._first.to("cpu"), self._second.to("cpu"), tuple(self._steps.values()))

    def load(self, state: AdamState) -> None:
        """Continue from a copy of `state`; the next steps equal those of the optimizer it is of."""
        device = self._first.means.device
        self._first, self._second = (
            moments.clone().to(device) for moments in (state.first, state.second)
        )
        self._steps = dict(zip(self._steps, state.steps, strict=True))


def check_fits(name: str, tensor: Tensor, parameter: Tensor) -> None:
    """Raise ValueError unless a gradient or a moment has the shape and type of its parameter."""
    if tensor.shape != parameter.shape:
        raise ValueError(
            f"Adam.{name}: expected one shape for parameter, gradient and moments, got"
            f" {tuple(parameter.shape)} and {tuple(tensor.shape)}; call edit() when the set of"
            " Gaussians changes"
        )
    if parameter.dtype != torch.float32 or tensor.dtype != torch.float32:
        raise ValueError(f"Adam.{name}: expected float32, got {parameter.dtype} and {tensor.dtype}")


def _none_yet(tensor: Tensor) -> Tensor:
    return torch.zeros(tensor.shape, dtype=torch.float32, device=tensor.device)
