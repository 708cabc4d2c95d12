"""Real checkpoints and what a forger makes of them."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import save
from torch import Tensor

from framework.errors import UserError
from framework.files.tree import encode
from framework.train.resume.checkpoint import KEY, Checkpoints
from framework.train.resume.training_state import TrainerState
from tests.contract.test_resume import Files, plugins, train

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
    """A real checkpoint at `STEP` of a training with the plugins of these names, to be changed."""

    def __init__(self, folder: Path, names: dict[str, str]) -> None:
        self.chosen = plugins(**names)
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
        return self.read_bytes(
            save(whole, {KEY: json.dumps({"identity": "identity", "tree": tree})})
        )

    def read_bytes(self, data: bytes) -> TrainerState | None:
        """What a run makes of a file of these bytes."""
        path = self.checkpoints().folder
        shutil.rmtree(path, ignore_errors=True)
        path.mkdir(parents=True)
        digest = hashlib.sha256(data).hexdigest()[:32]
        (path / f"step-{STEP:09d}-{digest}.safetensors").write_bytes(data)
        return self.checkpoints().newest(self.files.check)

    def goes_on(self, state: TrainerState) -> None:
        """The training ends, or reports that it diverged."""
        try:
            train(self.chosen, start=dataclasses.replace(state, step=max(state.step, 19)))
        except UserError as error:
            assert "training step" in str(error) or "Fisher information" in str(error)


def leaves(node: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any, Any]]:
    """(names on the way, container, key) of every text, number and None in the tree."""
    children = node.items() if isinstance(node, dict) else enumerate(node)
    for key, child in list(children):
        named = isinstance(key, str) and key not in ("fields", "tuple", "list")
        inner = (*path, key) if named else path
        if isinstance(child, dict | list):
            yield from leaves(child, inner)
        else:
            yield inner, node, key


Forged = tuple[str, Any, dict[str, Tensor]]  # what was changed, the tree, the tensors


def forgeries(forgery: Forgery, below: str = "") -> Iterator[Forged]:
    """Every forgery of the part of the state that is called `below`, or of all: each kind of
    number, text and name by each odd one, each key and each tensor gone, each tensor of another
    shape, type or content."""
    tree, tensors = copy.deepcopy(forgery.tree), forgery.tensors
    places = [place for place in leaves(tree) if not below or below in place[0]]
    for node, key in {
        (path[-2:], type(node[key])): (node, key) for path, node, key in places
    }.values():
        before = node[key]
        for odd in ODD:
            node[key] = odd
            yield f"{key}={odd!r:.12}", tree, tensors
        if isinstance(node, dict):
            del node[key]
            yield f"no {key}", tree, tensors
        node[key] = before
    for name in sorted({str(node[key]) for _, node, key in places} & tensors.keys()):
        yield f"no {name}", tree, {n: t for n, t in tensors.items() if n != name}
        for change, forge in CHANGES.items():
            if tensors[name].dim() > 0:
                yield f"{name}: {change}", tree, {**tensors, name: forge(tensors[name])}
