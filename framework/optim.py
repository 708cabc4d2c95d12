"""Adam over the tensors of a `Gaussians`: one numba kernel, in place, no allocation per step.

Kingma & Ba 2015, "Adam", algorithm 1, with the constants of 3DGS: beta = (0.9, 0.999), eps = 1e-15.
Every element is computed alone, in float32 and without contraction, so the bits do not depend on
threads or blocks. Plain twin: `torch.optim.Adam` (tests compare).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from framework.jit import kernel
from framework.parallel import BLOCKS, run_blocks
from framework.rasterize.chunks import put1, take1
from framework.rasterize.simd import LANES, exp2, log2, maximum, splat
from framework.types import Gaussians, edited

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15
LOWEST_LOGIT = -30.0
_LN2, _LOG2E = np.float32(math.log(2)), np.float32(1 / math.log(2))

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
        gradients = dict(grads.items())
        if self._views is None or self._views[0] is not params:
            self._views = params, self._flat_views(params)
        rows: list[tuple[np.ndarray, ...]] = []
        for k, (name, parameter) in enumerate(params.items()):
            gradient = gradients.get(name)
            if gradient is None:
                rows.append(_NOTHING)
                continue
            _check(name, gradient, parameter)
            self._steps[name] += 1
            self._coefficients[k] = _coefficients(self._steps[name], rates[name])
            p, m, v = self._views[1][k]
            rows.append((p, _flat(gradient.contiguous()), m, v))
        p, g, m, v = zip(*rows, strict=True)
        broken = np.zeros((BLOCKS, len(rows)), dtype=np.int32)
        logits, decay = _flat(params.opacity_logits), np.float32(opacity_decay)
        run_blocks(adam_kernel, p, g, m, v, self._coefficients, broken, logits, decay)
        return tuple(name for name, n in zip(self._steps, broken.sum(0), strict=True) if n > 0)

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


@kernel
def _adam_range(p, g, m, v, rate, correction):  # type: ignore[no-untyped-def]
    """p -= rate * m / (sqrt(v) * correction + eps), after the moments m and v took g in; returns
    how many p or v are not finite now.

    rate = learning rate / (1 - beta1^t), correction = 1 / sqrt(1 - beta2^t). A first moment below
    1e-30 becomes 0: it moves a parameter by less than 1e-15 rates, and decaying moments of unseen
    Gaussians would otherwise end as denormals, which cost six times as much.
    """
    beta1, beta2 = np.float32(BETA1), np.float32(BETA2)
    # not 1 - float32(beta), whose rounding is 1e-5 of a share this small
    share1, share2 = np.float32(1 - BETA1), np.float32(1 - BETA2)
    eps, tiny, infinity = np.float32(EPS), np.float32(1e-30), np.float32(np.inf)
    finite = np.int32(0)
    for i in range(len(p)):
        first = beta1 * m[i] + share1 * g[i]
        first = first if abs(first) >= tiny else np.float32(0)
        second = beta2 * v[i] + share2 * (g[i] * g[i])
        m[i] = first
        v[i] = second
        value = p[i] - rate * first / (np.sqrt(second) * correction + eps)
        p[i] = value
        # an integer sum, which the compiler may reorder and so vectorise; NaN compares false
        finite += np.int32(abs(value) + second < infinity)
    return len(p) - finite


@kernel
def _decay_range(logits, begin, end, decay):  # type: ignore[no-untyped-def]
    """Multiply the opacities sigmoid(logits[begin:end]) by `decay` in (0, 1).

    d sigmoid(l) = sigmoid(l'), l' = log d - log(1 - d + exp(-l)); Binocular3DGS applies such a
    decay so that Gaussians which no view confirms fade.
    """
    log_decay, lowest = np.float32(math.log(decay)), splat(np.float32(LOWEST_LOGIT))
    kept, scratch = np.float32(1) - decay, np.empty(LANES, np.float32)
    for base in range(begin, end, LANES):
        count = min(LANES, end - base)
        # exp(88) overflows; an opacity of 1e-13 is as good as none
        bounded = maximum(take1(logits, base, count, scratch), lowest)
        decayed = log_decay - _LN2 * log2(kept + exp2(-bounded * _LOG2E))
        put1(logits, base, count, scratch, maximum(decayed, lowest))


@kernel
def adam_kernel(  # type: ignore[no-untyped-def]
    block, n_blocks, p, g, m, v, coefficients, broken, logits, decay
):
    """Block `block` of one Adam update of several tensors, and of the decay of opacities after it.

    p, g, m, v: tuples of flat float32 arrays (parameters, gradients, moments), all C-contiguous.
    coefficients: [len(p), 2] float32, see `_adam_range`. broken: [n_blocks, len(p)] int32, out.
    logits [N], one of p unless it has no gradient, and decay: see `_decay_range`.
    """
    for k in range(len(p)):
        n = len(p[k])
        a, b = n * block // n_blocks, n * (block + 1) // n_blocks
        rate, correction = coefficients[k, 0], coefficients[k, 1]
        broken[block, k] = _adam_range(p[k][a:b], g[k][a:b], m[k][a:b], v[k][a:b], rate, correction)
    if decay < 1 and not np.any(broken[block]):  # of what broke the error tells what it is
        n = len(logits)
        _decay_range(logits, n * block // n_blocks, n * (block + 1) // n_blocks, decay)


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
