"""Values go through JSON and tensors unchanged, and nothing unknown is made of a file."""

import json
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import torch

from framework.errors import UserError
from framework.files.tree import decode, encode


@dataclass(frozen=True)
class Pair:
    first: Any
    second: Any = None


@dataclass(frozen=True)
class Stranger:
    value: int


def through(value: Any) -> Any:
    tree, tensors = encode(value, [Pair], "test")
    return decode(json.loads(json.dumps(tree)), tensors, [Pair])


@pytest.mark.parametrize(
    "value",
    [
        *(None, True, 0, -(2**70), "", "ü\n", 0.1, 5e-324, -0.0, math.inf),
        *((), [], {}, (1, [2, (3,)]), {"a": 1, 2: (None,), 1.5: "x", (1, 2): 3}),
        Pair(Pair(1), {"tensor": "a text", "class": [1]}),
    ],
    ids=repr,
)
def test_plain_values(value: Any) -> None:
    back = through(value)
    assert back == value and type(back) is type(value)
    assert repr(back) == repr(value)


@pytest.mark.parametrize(
    "dtype", [torch.float64, torch.float32, torch.bfloat16, torch.int64, torch.uint8, torch.bool]
)
@pytest.mark.parametrize("shape", [(), (0, 3), (5,), (2, 3, 4)])
def test_tensors(dtype: torch.dtype, shape: tuple[int, ...]) -> None:
    tensor = torch.arange(math.prod(shape)).reshape(shape).to(dtype)
    back = through(tensor)
    assert back.dtype == dtype and torch.equal(back, tensor)


def test_the_order_in_memory_is_kept() -> None:
    """A sum over another order would round differently."""
    planar = torch.arange(24.0).reshape(2, 4, 3).permute(2, 0, 1)
    back = through(planar)
    assert torch.equal(back, planar) and back.stride() == planar.stride()
    array = np.arange(6.0).reshape(2, 3).T
    assert through(array).strides == array.strides
    assert torch.equal(through(torch.arange(9)[::2]), torch.arange(0, 9, 2))


@pytest.mark.parametrize(
    "value", [object(), {1, 2}, Stranger(1), [lambda: 1], b"bytes", np.random.default_rng(0)]
)
def test_what_cannot_be_held_is_told(value: Any) -> None:
    with pytest.raises(UserError, match=r"test: expected a state of numbers.*CONTRIBUTING"):
        through(value)


def test_a_file_cannot_name_a_class_that_is_not_allowed() -> None:
    tree, tensors = encode(Stranger(1), [Stranger], "test")
    with pytest.raises(KeyError):
        decode(tree, tensors, [Pair])
    for name in ("builtins.eval", "os.system", "subprocess.Popen"):
        with pytest.raises(KeyError):
            decode({"class": name, "fields": {"args": "true"}}, {}, [Pair])
