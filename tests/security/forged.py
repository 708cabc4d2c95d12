"""Real checkpoints and what a forger makes of them."""

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
    "an axis more": lambda t: t[None],
    "integers": lambda t: t.to(torch.int32),
    "not numbers": lambda t: filled(t, float("nan")),
    "huge": lambda t: filled(t, 1e30),
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
