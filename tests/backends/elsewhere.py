"""A device for tests where there is no GPU: whatever is computed with tensors of both places fails.

Its tensors hold their numbers in the CPU's memory but say that they are on `DEVICE`. As on CUDA:
an operation takes tensors of one device, scalars of the CPU aside and a CPU's index of what is
indexed; `copy_` and `to` go across, NumPy does not. A tensor that a training leaves behind, or a
constant created on the CPU inside a loss, is therefore an error, as on CUDA.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, return_and_correct_aliasing

DEVICE = "meta"  # which torch knows without any hardware; its own holds no numbers
ACROSS = ("aten.copy_", "aten._to_copy")
BY_INDEX = ("aten.index.Tensor", "aten.index_put", "aten._index_put_impl_")


class There(Tensor):
    """A tensor of that device. here: its numbers."""

    here: Tensor

    @staticmethod
    def __new__(cls, inner: Tensor) -> There:
        return Tensor._make_wrapper_subclass(
            cls,
            inner.size(),
            strides=inner.stride(),
            storage_offset=inner.storage_offset(),
            dtype=inner.dtype,
            device=DEVICE,
        )

    def __init__(self, inner: Tensor) -> None:
        self.here = inner

    def tolist(self) -> Any:
        return self.cpu().tolist()

    def new_tensor(self, data: Any, *, dtype: Any = None) -> Tensor:
        return torch.tensor(data, dtype=dtype or self.dtype).to(DEVICE)

    def __getitem__(self, index: Any) -> Tensor:
        return super().__getitem__(_of_lists(index))

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(_of_lists(index), value)

    __torch_function__ = torch._C._disabled_torch_function_impl

    @classmethod
    def __torch_dispatch__(
        cls, op: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        return computed(op, args, kwargs or {})


def _of_lists(index: Any) -> Any:
    """Replace lists in an index by tensors; those torch creates would hold no numbers."""
    whole = index if isinstance(index, tuple) else (index,)
    whole = tuple(torch.tensor(i).to(DEVICE) if isinstance(i, list) else i for i in whole)
    return whole if isinstance(index, tuple) else whole[0]


class FromNumbers(TorchFunctionMode):
    """`torch.tensor` there: torch itself would keep no numbers."""

    def __torch_function__(
        self, function: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        if function not in (torch.tensor, torch.as_tensor) or kwargs.get("device") is None:
            return function(*args, **kwargs)
        device = kwargs.pop("device")
        return function(*args, **kwargs).to(device)


class Elsewhere(TorchDispatchMode):
    """While it is entered, tensors can be made there or brought there."""

    def __enter__(self) -> Any:
        self.numbers = FromNumbers()
        self.numbers.__enter__()
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self.numbers.__exit__(*error)

    def __torch_dispatch__(
        self, op: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        return computed(op, args, kwargs or {})


def computed(op: Any, args: tuple[Any, ...], kwargs: Mapping[str, Any]) -> Any:
    """What the operation gives, on the device that CUDA would give it on."""
    tensors = list(_tensors((*args, *kwargs.values())))
    there = any(isinstance(t, There) for t in tensors)
    if there:
        _same_device(str(op), args, tensors)
    if kwargs.get("device") is not None:
        there = torch.device(kwargs["device"]).type == DEVICE
        kwargs = {**kwargs, "device": "cpu"}
    if op is torch.ops.aten._to_copy.default and not kwargs.keys() - {"device", "non_blocking"}:
        result = _here(args[0]).clone()  # to the same place and type it would be no copy
    else:
        result = op(*map(_here, args), **{k: _here(v) for k, v in kwargs.items()})
    if op is torch.ops.aten._local_scalar_dense.default or not there:
        return result
    return return_and_correct_aliasing(op, args, dict(kwargs), _there(result))


def _tensors(values: Any) -> Iterator[Tensor]:
    for value in values:
        if isinstance(value, Tensor):
            yield value
        elif isinstance(value, (list, tuple)):
            yield from _tensors(value)


def _here(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return type(value)(map(_here, value))
    return value.here if isinstance(value, There) else value


def _there(value: Any) -> Any:
    if isinstance(value, (list, tuple)):
        return type(value)(map(_there, value))
    return There(value) if isinstance(value, Tensor) else value


def _same_device(op: str, args: tuple[Any, ...], tensors: list[Tensor]) -> None:
    """Raise where CUDA would."""
    if op.startswith(ACROSS):
        return
    if op.startswith(BY_INDEX):
        tensors = [t for t in tensors if not any(t is i for i in args[1])]
    left = [t for t in tensors if not isinstance(t, There) and t.dim() > 0]
    if left:
        raise RuntimeError(
            f"{op}: expected all tensors on one device, got one of shape {list(left[0].shape)}"
            f" on {left[0].device} beside others on the device"
        )
