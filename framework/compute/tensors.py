"""Functions of tensors, differentiable, whose bits on the CPU depend on no processor.

PyTorch hands square roots and exponentials to MKL, whose code is chosen by the processor and does
not round alike everywhere (`benchmarks/results/robustness.md` has figures). NumPy's square root is
the processor's, which IEEE 754 defines; the others are `framework.compute.portable`'s, rounded to
the tensor's type. Gradients are those of the definitions. On other devices they are PyTorch's.
"""

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from framework.compute import portable


def checksum(tensor: Tensor) -> int:
    """A CRC-32 of the values."""
    return zlib.crc32(tensor.detach().contiguous().cpu().numpy().tobytes())


def root(x: Tensor) -> Tensor:
    """The square root, of the shape and type of x."""
    return _computed(x, np.sqrt, lambda g, y: g / (2 * y)) if x.is_cpu else x.sqrt()


def exp(x: Tensor) -> Tensor:
    """e^x, of the shape and type of x."""
    return _computed(x, portable.exp, lambda g, y: g * y) if x.is_cpu else x.exp()


def sigmoid(x: Tensor) -> Tensor:
    """1 / (1 + e^-x), of the shape and type of x."""
    if not x.is_cpu:
        return x.sigmoid()
    return _computed(x, portable.sigmoid, lambda g, y: g * y * (1 - y))


def _computed(
    x: Tensor, function: Callable[[Any], Any], pull_back: Callable[[Tensor, Tensor], Tensor]
) -> Tensor:
    result: Tensor = _Computed.apply(x, function, pull_back)  # type: ignore[no-untyped-call]
    return result


class _Computed(Function):
    """An elementwise function of NumPy's arrays, so its derivative is diagonal.

    pull_back: (gradient in the value, value) -> gradient in x; also takes tangents forward.
    """

    @staticmethod
    def forward(ctx: Any, x: Tensor, function: Any, pull_back: Any) -> Tensor:
        result = torch.from_numpy(np.asarray(function(x.detach().numpy()))).to(x.dtype)
        ctx.save_for_backward(result)
        ctx.save_for_forward(result)
        ctx.pull_back = pull_back
        return result

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (result,) = ctx.saved_tensors
        return ctx.pull_back(gradient, result), None, None

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor, *_: None) -> Tensor:
        (result,) = ctx.saved_tensors
        moved: Tensor = ctx.pull_back(tangent, result)
        return moved
