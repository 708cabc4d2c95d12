"""A forged checkpoint: whatever it contains, the training continues or ignores the file."""

import copy
import io
import json
import logging
import pickle
from itertools import islice
from typing import Any

import pytest
import torch
from safetensors.torch import save

from framework.train.resume.checkpoint import KEY
from tests.contract.test_training import ACTING
from tests.security.forged import CHANGES, ODD, Forgery, leaves


@pytest.fixture(scope="module")
def forgery(tmp_path_factory: pytest.TempPathFactory) -> Forgery:
    return Forgery(tmp_path_factory.mktemp("forgery"), ACTING)


def test_the_real_one_is_used(forgery: Forgery) -> None:
    assert forgery.read(forgery.tree, forgery.tensors) is not None


@pytest.mark.parametrize("change", CHANGES)
def test_tensors_that_do_not_fit(
    forgery: Forgery, change: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Each of the state's tensors in turn: Gaussians, moments, views, the plugins' own."""
    refused = 0
    for name, tensor in forgery.tensors.items():
        caplog.clear()
        if tensor.dim() == 0:
            continue
        forged = CHANGES[change](tensor)
        with caplog.at_level(logging.WARNING, "framework"):
            state = forgery.read(forgery.tree, {**forgery.tensors, name: forged})
        if state is None:
            refused += 1
            assert caplog.text.count("\n") == 1 and "is damaged and not used: " in caplog.text
        else:
            forgery.goes_on(state)
    assert refused > 0


@pytest.mark.parametrize("first", range(0, len(ODD), 3))
def test_values_that_do_not_fit(forgery: Forgery, first: int) -> None:
    """A third of the kinds of numbers, texts and names of the state in turn, by an odd one."""
    odd = ODD[first]
    tree = copy.deepcopy(forgery.tree)
    kinds = {
        (path[-2:], type(node[key])): (node, key) for path, node, key in leaves(tree)
    }  # the last of each: views and rows of history are alike
    assert len(kinds) > 60
    for node, key in islice(kinds.values(), first % 3, None, 3):
        before, node[key] = node[key], odd
        state = forgery.read(tree, forgery.tensors)
        if state is not None:
            forgery.goes_on(state)
        node[key] = before


def test_files_that_hold_something_else(forgery: Forgery, caplog: pytest.LogCaptureFixture) -> None:
    """Under a name with their right checksum; a pickle is not opened as one."""
    promised = json.dumps({"a": {"dtype": "F32", "shape": [2**40], "data_offsets": [0, 2**42]}})
    contents = {
        "nothing": b"",
        "a pickle": pickle.dumps(Exploding()),
        "PyTorch's": torch_file(),
        "a promise of 4 TB": len(promised).to_bytes(8, "little") + promised.encode(),
        "a header of 2^60 bytes": (2**60).to_bytes(8, "little") + b"{}",
        "no values": save({"a": torch.zeros(1)}),
        "odd values": save({}, {KEY: "[" * 100_000}),
        "another key": save({}, {KEY: json.dumps({"identity": "identity"})}),
        "no training": save({}, {KEY: json.dumps({"identity": "identity", "tree": 1})}),
    }
    for what, data in contents.items():
        caplog.clear()
        with caplog.at_level(logging.WARNING, "framework"):
            assert forgery.read_bytes(data) is None, what
        assert caplog.text.count("\n") == 1 and "is damaged and not used: " in caplog.text, what


class Exploding:
    def __reduce__(self) -> tuple[Any, ...]:
        return pytest.fail, ("a pickle was opened",)


def torch_file() -> bytes:
    buffer = io.BytesIO()
    torch.save({"step": 7, "means": torch.zeros(3)}, buffer)
    return buffer.getvalue()
