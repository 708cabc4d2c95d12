"""Functions of tensors on the CPU, differentiable, whose bits depend on no processor.

PyTorch hands square roots, exponentials and logarithms to MKL, which rounds them by the processor
and its maker: on an Intel with AVX-512 one square root of float32 in a hundred is off by the last
bit (`tests/laws/test_portable.py` says how many where it runs). NumPy's square root is the
processor's, which IEEE 754 defines; the others are `framework.compute.portable`'s, rounded to the
tensor's type. Gradients are those of the definitions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd import Function

from framework.compute import portable


def root(x: Tensor) -> Tensor:
    """The square root, of the shape and type of x."""
    result: Tensor = _Root.apply(x)  # type: ignore[no-untyped-call]
    return result


def exp(x: Tensor) -> Tensor:
    """e^x, of the shape and type of x."""
    result: Tensor = _Exp.apply(x)  # type: ignore[no-untyped-call]
    return result


def sigmoid(x: Tensor) -> Tensor:
    """1 / (1 + e^-x), of the shape and type of x."""
    result: Tensor = _Sigmoid.apply(x)  # type: ignore[no-untyped-call]
    return result


def _each(function: Callable[[Any], Any], x: Tensor) -> Tensor:
    return torch.from_numpy(np.asarray(function(x.detach().numpy()))).to(x.dtype)


class _Root(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        found = _each(np.sqrt, x)
        ctx.save_for_backward(found)
        return found

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (found,) = ctx.saved_tensors
        return gradient / (2 * found)


class _Exp(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        found = _each(portable.exp, x)
        ctx.save_for_backward(found)
        return found

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (found,) = ctx.saved_tensors
        return gradient * found


class _Sigmoid(Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        found = _each(portable.sigmoid, x)
        ctx.save_for_backward(found)
        return found

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (found,) = ctx.saved_tensors
        return gradient * found * (1 - found)
