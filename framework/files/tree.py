"""Encodes values as plain JSON and named tensors, and decodes them. The JSON cannot name code.

Supported are None, booleans, numbers, strings, tensors, arrays, tuples, lists, dicts, and
dataclasses among the `classes` that the caller allows; decoding looks up classes only there. A
tensor keeps its bits, dtype, shape and memory order (reductions in another order would round
differently). Tensors that were one object stay one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.errors import require

PLAIN = (type(None), bool, int, float, str)


def encode(value: Any, classes: Iterable[type], owner: str) -> tuple[Any, dict[str, Tensor]]:
    """Encode to (JSON value, name -> contiguous tensor, which may share memory with the value).

    Args:
        owner: for messages.

    Raises:
        UserError: for an unsupported value.
    """
    encoder = _Encoder({_name(cls): cls for cls in classes}, owner)
    return encoder.node(value), encoder.tensors


def decode(node: Any, tensors: Mapping[str, Tensor], classes: Iterable[type]) -> Any:
    """Inverse of `encode`.

    Raises:
        ValueError, KeyError or TypeError: for damaged input.
    """
    return _Decoder({_name(cls): cls for cls in classes}, tensors).value(node)


class _Encoder:
    def __init__(self, classes: Mapping[str, type], owner: str) -> None:
        self.classes, self.owner = classes, owner
        self.tensors: dict[str, Tensor] = {}
        self.memory: set[int] = set()  # the storages of `tensors`
        self.seen: dict[int, tuple[Any, Any]] = {}  # id -> (the object, kept alive, and its node)

    def node(self, value: Any) -> Any:
        if type(value) in PLAIN:
            return value
        if isinstance(value, Tensor | np.ndarray):
            return self._shared(value)
        if isinstance(value, np.generic):
            return {"scalar": self._tensor(torch.from_numpy(np.asarray(value)))}
        if type(value) in (tuple, list):
            return {type(value).__name__: [self.node(item) for item in value]}
        if type(value) is dict:
            return {"dict": [[self.node(k), self.node(v)] for k, v in value.items()]}
        return self._dataclass(value)

    def _dataclass(self, value: Any) -> Any:
        name = _name(type(value))
        require(
            self.classes.get(name) is type(value),
            f"{self.owner}: expected a state of numbers, texts, tensors, arrays, tuples, lists,"
            f" dicts and dataclasses of the same module, got {name}; see CONTRIBUTING.md, State",
        )
        stored = [f.name for f in dataclasses.fields(value) if f.init]
        return {"class": name, "fields": {key: self.node(getattr(value, key)) for key in stored}}

    def _shared(self, value: Tensor | np.ndarray) -> Any:
        if id(value) not in self.seen:
            if isinstance(value, np.ndarray):
                node = {"array": self._tensor(torch.from_numpy(value))}
            else:
                node = {"tensor": self._tensor(value.detach()), "grad": value.requires_grad}
            self.seen[id(value)] = (value, node)
        return self.seen[id(value)][1]

    def _tensor(self, tensor: Tensor) -> Any:
        """Store a tensor contiguously; the node contains the order of its axes in memory."""
        strides = tensor.stride()
        order = sorted(range(tensor.dim()), key=lambda axis: -strides[axis])
        name = str(len(self.tensors))
        stored = tensor.permute(order).contiguous()
        # the format refuses tensors that share memory, as cameras' matrices may
        if stored.untyped_storage().data_ptr() in self.memory:
            stored = stored.clone()
        self.memory.add(stored.untyped_storage().data_ptr())
        self.tensors[name] = stored
        return {"name": name, "order": order}


class _Decoder:
    def __init__(self, classes: Mapping[str, type], tensors: Mapping[str, Tensor]) -> None:
        self.classes, self.stored = classes, tensors
        self.decoded: dict[tuple[str, str], Any] = {}

    def value(self, node: Any) -> Any:
        if type(node) in PLAIN:
            return node
        if "class" in node:
            fields = {key: self.value(item) for key, item in node["fields"].items()}
            return self.classes[node["class"]](**fields)
        (kind, content), *rest = node.items()
        if kind in ("tensor", "array", "scalar"):
            key = (kind, content["name"])
            if key not in self.decoded:
                self.decoded[key] = self._tensor(kind, content, bool(rest and rest[0][1]))
            return self.decoded[key]
        if kind == "dict":
            return {self.value(k): self.value(v) for k, v in content}
        items = [self.value(item) for item in content]
        return {"tuple": tuple, "list": list}[kind](items)

    def _tensor(self, kind: str, content: Mapping[str, Any], grad: bool) -> Any:
        stored = self.stored[content["name"]]
        tensor = stored.permute(np.argsort(content["order"], kind="stable").tolist())
        if kind == "tensor":
            return tensor.requires_grad_() if grad else tensor
        return tensor.numpy() if kind == "array" else tensor.numpy()[()]


def _name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"
