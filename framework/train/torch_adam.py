"""Adam in torch, for parameters on any device: the arithmetic of `framework.train.adam_kernels`."""

import math

import torch
from torch import Tensor

from framework.backends import Rasterizer, RenderGradient
from framework.train.adam_kernels import BETA1, BETA2, EPS, LOWEST_LOGIT
from framework.train.optim import Adam
from framework.train.optimizer import Grads, Names, Optimizer, Rates, check_fits
from framework.types import Gaussians


def optimizer_of(rasterizer: Rasterizer, params: Gaussians) -> Optimizer:
    """Adam for the gradients of this rasterizer, with its moments where `params` are."""
    return Adam(params) if rasterizer.fused else TorchAdam(params)


class TorchAdam(Optimizer):
    """`optim.Adam` in torch."""

    @torch.no_grad()
    def step(self, params: Gaussians, grads: Grads, rates: Rates, decay: float = 1.0) -> Names:
        """See `Optimizer`."""
        gradients = {name: gradient for name, gradient in grads.items() if gradient is not None}
        if not gradients:
            return ()
        names, pull = list(gradients), list(gradients.values())
        at, first, second = (
            [getattr(of, name) for name in names] for of in (params, self._first, self._second)
        )
        for name, gradient, parameter, moment in zip(names, pull, at, first, strict=True):
            check_fits(name, gradient, parameter)
            check_fits(name, moment, parameter)
            self._steps[name] += 1
        rate = [-rates[name] / (1 - BETA1 ** self._steps[name]) for name in names]
        correction = [1 / math.sqrt(1 - BETA2 ** self._steps[name]) for name in names]
        # all tensors at once: what a GPU is given costs more time here than its arithmetic
        torch._foreach_mul_(first, BETA1)
        torch._foreach_add_(first, pull, alpha=1 - BETA1)
        torch._foreach_mul_(second, BETA2)
        torch._foreach_addcmul_(second, pull, pull, value=1 - BETA2)
        width = torch._foreach_sqrt(second)
        torch._foreach_mul_(width, correction)
        torch._foreach_add_(width, EPS)
        torch._foreach_addcdiv_(at, first, width, rate)
        # the sum of sizes is finite only where all are; asked at once, as a question waits
        sizes = torch.stack(torch._foreach_norm([*at, *second], 1)).isfinite().tolist()
        whole = [a and b for a, b in zip(sizes, sizes[len(names) :], strict=False)]
        broken = tuple(name for name, fine in zip(names, whole, strict=True) if not fine)
        if decay < 1 and not broken:
            _fade(params.opacity_logits, decay)
        return broken

    def step_from(
        self, gradient: RenderGradient, rates: Rates, decay: float = 1.0
    ) -> tuple[Names, Tensor]:
        """See `Optimizer`."""
        tensors, means2d = gradient.pull_back()
        return self.step(gradient.gaussians, tensors, rates, decay), means2d


def _fade(logits: Tensor, decay: float) -> None:
    """Multiply the opacities by `decay`, as `adam_kernels._decay_range`."""
    bounded = logits.clamp(min=LOWEST_LOGIT)
    decayed = math.log(decay) - (1 - decay + (-bounded).exp()).log()
    logits.copy_(decayed.clamp(min=LOWEST_LOGIT))
