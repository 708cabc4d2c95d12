"""A forged checkpoint: whatever stands in it, the training goes on or the file is not used."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import logging
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import save
from torch import Tensor

from framework.errors import UserError
from framework.files.tree import encode
from framework.train.resume.checkpoint import KEY, Checkpoints
from framework.train.resume.training_state import TrainerState
from tests.contract.test_resume import Files, plugins, train
from tests.contract.test_training import ACTING

STEP = 7
ODD = (None, True, -1, 2**70, 10**400, 1e300, float("nan"), float("inf"), "x", {}, [], {"dict": []})


def filled(tensor: Tensor, value: float) -> Tensor:
    """A new tensor; the real one stays as it is for the next forgery."""
    return torch.full(tensor.shape, value).to(tensor.dtype)


CHANGES: dict[str, Callable[[Tensor], Tensor]] = {
    "a row less": lambda t: t[:-1],
    "a row more": lambda t: torch.cat([t, t[:1]]),
    "nothing": lambda t: t[:0],
    "an axis more": lambda t: t[None],
    "one axis": lambda t: t.reshape(-1),
    "half as wide": lambda t: t[..., : t.shape[-1] // 2],
    "integers": lambda t: t.to(torch.int32),
    "doubles": lambda t: t.to(torch.float64),
    "not numbers": lambda t: filled(t, float("nan")),
    "infinite": lambda t: filled(t, float("inf")),
    "huge": lambda t: filled(t, 1e30),
    "negative": lambda t: filled(t, -7.0),
}


class Forgery:
    """A real checkpoint at `STEP` of a training with plugins that have states, to be changed."""

    def __init__(self, folder: Path) -> None:
        self.chosen = plugins(**ACTING)
        self.files, self.folder = Files(folder, self.chosen), folder / "forged"
        train(self.chosen, self.files)
        state = self.files.checkpoints(STEP).newest(self.files.check)
        assert state is not None
        self.tree, self.tensors = encode(state, self.checkpoints().classes, "test")

    def checkpoints(self) -> Checkpoints:
        return Checkpoints(self.folder, "identity", self.files.chosen)

    def read(self, tree: Any, tensors: dict[str, Tensor]) -> TrainerState | None:
        """What a run makes of these contents under a right checksum."""
        whole = {name: tensor.contiguous().clone() for name, tensor in tensors.items()}
        data = save(whole, {KEY: json.dumps({"identity": "identity", "tree": tree})})
        path = self.checkpoints().folder
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        digest = hashlib.sha256(data).hexdigest()[:32]
        (path / f"step-{STEP:09d}-{digest}.safetensors").write_bytes(data)
        return self.checkpoints().newest(self.files.check)

    def goes_on(self, state: TrainerState) -> None:
        """The training ends, or tells that it diverged."""
        try:
            train(self.chosen, start=dataclasses.replace(state, step=max(state.step, 19)))
        except UserError as error:
            assert "training step" in str(error) or "Fisher information" in str(error)


@pytest.fixture(scope="module")
def forgery(tmp_path_factory: pytest.TempPathFactory) -> Forgery:
    return Forgery(tmp_path_factory.mktemp("forgery"))


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


def leaves(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """(names on the way, container, key) of every text, number and None in the tree."""
    children = node.items() if isinstance(node, dict) else enumerate(node)
    for key, child in list(children):
        named = isinstance(key, str) and key not in ("fields", "tuple", "list")
        here = (*path, key) if named else path
        if isinstance(child, dict | list):
            yield from leaves(child, here)
        else:
            yield here, node, key


@pytest.mark.parametrize("odd", ODD, ids=[f"{odd!r:.8}" for odd in ODD])
def test_values_that_do_not_fit(forgery: Forgery, odd: Any) -> None:
    """Each kind of number, text and name of the state in turn, by one of the odd ones."""
    tree = copy.deepcopy(forgery.tree)
    kinds = {
        (path[-2:], type(node[key])): (node, key) for path, node, key in leaves(tree)
    }  # the last of each: views and rows of history are alike
    assert len(kinds) > 60
    for node, key in kinds.values():
        before, node[key] = node[key], odd
        state = forgery.read(tree, forgery.tensors)
        if state is not None:
            forgery.goes_on(state)
        node[key] = before
