"""Adam over the tensors of a `Gaussians`: numba kernels, in place.

Kingma & Ba 2015, "Adam", algorithm 1, with the constants of 3DGS: beta = (0.9, 0.999), eps = 1e-15.
Plain twin: `torch.optim.Adam` (tests compare).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.compute.parallel import BLOCKS, run_blocks, threads
from framework.rasterize import ScreenGradient, give_back
from framework.rasterize.lending import aligned
from framework.train.adam_kernels import BETA1, BETA2, CHUNK, adam_kernel, pull_back_and_step
from framework.types import Gaussians, edited

# stands for a tensor without gradient: tuples of another length would be compiled anew
_NOTHING = (np.empty(0, dtype=np.float32),) * 4


@dataclass(frozen=True)
class AdamState:
    """All that Adam remembers. first, second: the moments, shaped like the parameters, float32.
    steps: finished updates of each tensor, in the order of `Gaussians.items()`."""

    first: Gaussians
    second: Gaussians
    steps: tuple[int, ...]


class Adam:
    """Adam for a set of Gaussians whose number may change.

    All tensors are contiguous float32 of shape like the `gaussians` given at construction.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        self._first = gaussians.map(_zeros_like)
        self._second = gaussians.map(_zeros_like)
        self._views: tuple[Gaussians, list[tuple[np.ndarray, ...]]] | None = None
        self._steps = dict.fromkeys((name for name, _ in gaussians.items()), 0)
        self._coefficients = np.zeros((len(self._steps), 2), dtype=np.float32)
        self._scratch: list[tuple[np.ndarray]] = []

    def step(
        self,
        params: Gaussians,
        grads: Gaussians | Mapping[str, Tensor | None],
        rates: Mapping[str, float],
        opacity_decay: float = 1.0,
    ) -> tuple[str, ...]:
        """Update `params` in place, then multiply the activated opacities by `opacity_decay` in
        (0, 1]; returns the names of tensors with a value or a second moment that is not finite now,
        which a gradient that is not finite always causes.

        grads: by tensor name, shaped like the parameters; a tensor without one (None or missing)
        is left alone, its moments too, as in torch. rates: learning rate of every tensor with a
        gradient, in the tensor's own units. Raises ValueError when shapes or dtypes differ. The
        tensors of one `params` object must stay where they are in memory.
        """
        gradients, views = dict(grads.items()), self._views_of(params)
        rows: list[tuple[np.ndarray, ...]] = []
        for k, (name, parameter) in enumerate(params.items()):
            gradient = gradients.get(name)
            if gradient is None:
                rows.append(_NOTHING)
                continue
            _check(name, gradient, parameter)
            self._steps[name] += 1
            self._coefficients[k] = _coefficients(self._steps[name], rates[name])
            p, m, v = views[k]
            rows.append((p, _flat(gradient.contiguous()), m, v))
        p, g, m, v = zip(*rows, strict=True)
        broken = np.zeros((BLOCKS, len(rows)), dtype=np.int32)
        logits, decay = _flat(params.opacity_logits), np.float32(opacity_decay)
        run_blocks(adam_kernel, p, g, m, v, self._coefficients, broken, logits, decay)
        return self._names(broken)

    def step_from(
        self, gradient: ScreenGradient, rates: Mapping[str, float], opacity_decay: float = 1.0
    ) -> tuple[tuple[str, ...], Tensor]:
        """`step` of `gradient.gaussians`, in place, by what `gradient.pull_back` returns: the same
        bits, but that gradient never is in memory as a whole, a few Gaussians' at a time is used
        while the cache has it. Uses `gradient` up.

        Returns what `step` does and, as `pull_back`, the gradient in the projected means [N, 2].
        Raises ValueError as `step`, and RuntimeError if `gradient` was used before.
        """
        params = gradient.gaussians
        p, m, v = zip(*self._views_of(params), strict=True)
        steps = {name: n + 1 for name, n in self._steps.items()}
        coefficients = [_coefficients(n, rates[name]) for name, n in steps.items()]
        work = gradient.take()  # what raises did so before
        self._steps, self._coefficients[:] = steps, coefficients
        broken = np.zeros((BLOCKS, len(p)), dtype=np.int32)
        (means2d,) = work.pulls.lend([(len(params), 2)])
        run_blocks(
            pull_back_and_step,
            p,
            work.backward_inputs(),
            means2d.reshape(-1),
            m,
            v,
            self._coefficients,
            broken,
            np.float32(opacity_decay),
            own=self._own(CHUNK * (15 + 3 * params.shN.shape[1])),
        )
        give_back(work)
        return self._names(broken), torch.from_numpy(means2d)

    def _own(self, size: int) -> list[tuple[np.ndarray]]:
        """Scratch for every thread."""
        if len(self._scratch) != threads() or len(self._scratch[0][0]) != size:
            self._scratch = [(aligned((size,), np.float32),) for _ in range(threads())]
        return self._scratch

    def _names(self, broken: np.ndarray) -> tuple[str, ...]:
        return tuple(name for name, n in zip(self._steps, broken.sum(0), strict=True) if n > 0)

    def _views_of(self, params: Gaussians) -> list[tuple[np.ndarray, ...]]:
        if self._views is None or self._views[0] is not params:
            self._views = params, self._flat_views(params)
        return self._views[1]

    def _flat_views(self, params: Gaussians) -> list[tuple[np.ndarray, ...]]:
        """Of every parameter and its moments, made once for many steps."""
        views: list[tuple[np.ndarray, ...]] = []
        for name, parameter in params.items():
            first, second = getattr(self._first, name), getattr(self._second, name)
            _check(name, first, parameter)
            if not parameter.is_contiguous():
                raise ValueError(
                    f"Adam.{name}: expected a contiguous parameter, to update it in place"
                )
            views.append((_flat(parameter), _flat(first), _flat(second)))
        return views

    def edit(self, keep: Tensor | None, bands: Tensor | None, append: Gaussians | None) -> None:
        """Follow a change of the set, see `types.edited`; the moments of new ones are zero."""
        self._views = None
        new = None if append is None else append.map(_zeros_like)
        self._first = edited(self._first, keep, bands, new)
        self._second = edited(self._second, keep, bands, new)

    def zero(self, name: str) -> None:
        """Forget the moments of one tensor. Its step count stays (as 3DGS does at an opacity
        reset), hence the bias correction is not repeated."""
        getattr(self._first, name).zero_()
        getattr(self._second, name).zero_()

    def state(self) -> AdamState:
        """What a checkpoint holds: the optimizer's own tensors, which its next step changes."""
        return AdamState(self._first, self._second, tuple(self._steps.values()))

    def load(self, state: AdamState) -> None:
        """Continue from a copy of `state`; the next steps equal those of the optimizer it is of."""
        self._views = None
        self._first, self._second = state.first.clone(), state.second.clone()
        self._steps = dict(zip(self._steps, state.steps, strict=True))


def _coefficients(step: int, rate: float) -> tuple[float, float]:
    """Bias-corrected rate and the factor of sqrt(v) at update number `step` (from 1)."""
    return rate / (1 - BETA1**step), 1 / math.sqrt(1 - BETA2**step)


def _flat(tensor: Tensor) -> np.ndarray:
    """A flat view of the same memory."""
    return tensor.detach().numpy().reshape(-1)


def _zeros_like(tensor: Tensor) -> Tensor:
    return torch.zeros(tensor.shape, dtype=torch.float32)


def _check(name: str, given: Tensor, parameter: Tensor) -> None:
    """That a gradient or a moment fits its parameter."""
    if given.shape != parameter.shape:
        raise ValueError(
            f"Adam.{name}: expected one shape for parameter, gradient and moments, got"
            f" {tuple(parameter.shape)} and {tuple(given.shape)}; call edit() when the set of"
            " Gaussians changes"
        )
    if parameter.dtype != torch.float32 or given.dtype != torch.float32:
        raise ValueError(f"Adam.{name}: expected float32, got {parameter.dtype} and {given.dtype}")
