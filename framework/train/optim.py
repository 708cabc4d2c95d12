"""Adam over the tensors of a `Gaussians`: numba kernels, in place.

Kingma & Ba 2015, "Adam", algorithm 1, with the constants of 3DGS: beta = (0.9, 0.999), eps = 1e-15.
Plain twin: `torch.optim.Adam` (tests compare).
"""

import math

import numpy as np
import torch
from torch import Tensor

from framework.backends import RenderGradient
from framework.compute.parallel import BLOCKS, run_blocks, threads
from framework.kernels import ScreenGradient, give_back
from framework.kernels.lending import aligned
from framework.train.adam_kernels import BETA1, BETA2, CHUNK, adam_kernel, pull_back_and_step
from framework.train.optimizer import AdamState, Grads, Names, Optimizer, Rates, check_fits
from framework.types import Gaussians

# replaces a tensor without gradient: tuples of another length would be compiled again
_NOTHING = (np.empty(0, dtype=np.float32),) * 4


class Adam(Optimizer):
    """The kernels; all tensors are contiguous, on the CPU."""

    def __init__(self, gaussians: Gaussians) -> None:
        super().__init__(gaussians)
        self._views: tuple[Gaussians, Gaussians, list[tuple[np.ndarray, ...]]] | None = None
        self._coefficients = np.zeros((len(self._steps), 2), dtype=np.float32)
        self._scratch: list[tuple[np.ndarray]] = []
        self._banded = False  # whether shN ever had a gradient

    def step(self, params: Gaussians, grads: Grads, rates: Rates, decay: float = 1.0) -> Names:
        """See `Optimizer`.

        Raises:
            ValueError: when shapes or dtypes differ. The tensors of one `params` object must stay
                where they are in memory.
        """
        gradients, views = dict(grads.items()), self._views_of(params)
        rows: list[tuple[np.ndarray, ...]] = []
        for k, (name, parameter) in enumerate(params.items()):
            gradient = gradients.get(name)
            if gradient is None:
                rows.append(_NOTHING)
                continue
            check_fits(name, gradient, parameter)
            self._banded |= name == "shN"
            self._steps[name] += 1
            self._coefficients[k] = _coefficients(self._steps[name], rates[name])
            p, m, v = views[k]
            rows.append((p, _flat(gradient.contiguous()), m, v))
        p, g, m, v = zip(*rows, strict=True)
        broken = np.zeros((BLOCKS, len(rows)), dtype=np.int32)
        logits, fading = _flat(params.opacity_logits), np.float32(decay)
        run_blocks(adam_kernel, p, g, m, v, self._coefficients, broken, logits, fading)
        return self._names(broken)

    def step_from(
        self, gradient: RenderGradient, rates: Rates, decay: float = 1.0
    ) -> tuple[Names, Tensor]:
        """See `Optimizer`: the gradient never is in memory as a whole, a few Gaussians' at a time
        is used while the cache has it.

        Raises:
            ValueError: as `step`, and RuntimeError if `gradient` was used before.
        """
        assert isinstance(gradient, ScreenGradient)
        params = gradient.gaussians
        p, m, v = zip(*self._views_of(params), strict=True)
        steps = {name: n + 1 for name, n in self._steps.items()}
        coefficients = [_coefficients(n, rates[name]) for name, n in steps.items()]
        work = gradient.take()  # what raises did so before
        self._banded |= work.degree > 0
        self._steps, self._coefficients[:] = steps, coefficients
        broken = np.zeros((BLOCKS, len(p)), dtype=np.int32)
        (means2d,) = work.pulls.lend([(len(params), 2)])
        run_blocks(
            pull_back_and_step,
            p,
            work.arrays.shN,
            work.arrays.factors,
            work.projected(),
            means2d.reshape(-1),
            m,
            v,
            self._coefficients,
            self._banded,
            broken,
            np.float32(decay),
            scratch=self._own(CHUNK * (15 + 3 * params.shN.shape[1])),
        )
        give_back(work)
        return self._names(broken), torch.from_numpy(means2d)

    def load(self, state: AdamState) -> None:
        super().load(state)
        self._banded = bool(self._first.shN.any() or self._second.shN.any())

    def _own(self, size: int) -> list[tuple[np.ndarray]]:
        """Scratch for every thread."""
        if len(self._scratch) != threads() or len(self._scratch[0][0]) != size:
            self._scratch = [(aligned((size,)),) for _ in range(threads())]
        return self._scratch

    def _names(self, broken: np.ndarray) -> Names:
        return tuple(name for name, n in zip(self._steps, broken.sum(0), strict=True) if n > 0)

    def _views_of(self, params: Gaussians) -> list[tuple[np.ndarray, ...]]:
        if self._views is None or not (self._views[0] is params and self._views[1] is self._first):
            self._views = params, self._first, self._flat_views(params)
        return self._views[2]

    def _flat_views(self, params: Gaussians) -> list[tuple[np.ndarray, ...]]:
        """Flat views of every parameter and its moments, made once for many steps."""
        views: list[tuple[np.ndarray, ...]] = []
        for name, parameter in params.items():
            first, second = getattr(self._first, name), getattr(self._second, name)
            check_fits(name, first, parameter)
            if not parameter.is_contiguous():
                raise ValueError(
                    f"Adam.{name}: expected a contiguous parameter, to update it in place"
                )
            views.append((_flat(parameter), _flat(first), _flat(second)))
        return views


def _coefficients(step: int, rate: float) -> tuple[float, float]:
    """Bias-corrected rate and the factor of sqrt(v) at update number `step` (from 1)."""
    return rate / (1 - BETA1**step), 1 / math.sqrt(1 - BETA2**step)


def _flat(tensor: Tensor) -> np.ndarray:
    """A flat view of the same memory."""
    return tensor.detach().numpy().reshape(-1)
