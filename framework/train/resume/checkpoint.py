"""Checkpoints of a run: `checkpoints/step-<finished steps>-<32 hex digits>.safetensors`.

The digits are of the SHA-256 of the file's bytes, so one rename makes file and checksum appear
together. safetensors files hold tensors and texts, nothing executable. The tree of values is JSON
in their metadata, see `framework.files.tree`. Two are kept: a damaged one is detected by its name,
and the previous one is used. A checkpoint belongs to one run identity.

The next one is due after 75 times the cost of the last one, so they take less than 2 % of a long
training. The cost of the first is estimated. Checkpoints change no result.
"""

import contextlib
import dataclasses
import hashlib
import json
import logging
import math
import re
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from framework import types
from framework.files.limits import CHECKPOINT_BYTES
from framework.files.opened import file_size, read_bytes
from framework.files.tree import decode, encode
from framework.files.whole import TEMPORARY, write_whole
from framework.fisher import information as fisher
from framework.records.run_files import HistoryRow
from framework.train import optimizer
from framework.train.resume.training_state import FieldState, PluginState, TrainerState
from framework.warp import zbuffer as warp

Check = Callable[[TrainerState], None]

LOG = logging.getLogger(__name__)
FOLDER, KEY = "checkpoints", "fishersplat"
NAME = re.compile(r"step-.*\.safetensors")
KEPT = 2
COST_TIMES = 75  # so many times a checkpoint's cost pass until the next
SLOW_DISK = 25e6  # bytes per second assumed before the first one was measured
FRAMEWORK_CLASSES = (
    *(types.Camera, types.View, types.DepthMap, types.SparsePoints, types.Gaussians, types.Render),
    *(warp.Support, fisher.FisherInformation, optimizer.AdamState),
    *(HistoryRow, PluginState, FieldState, TrainerState),
)


def state_classes(plugins: Iterable[Any]) -> list[type]:
    """The dataclasses that the states of these plugins may be built of: the framework's own, and
    those found in the modules of the plugins' classes and their bases."""
    modules = {cls.__module__ for plugin in plugins for cls in type(plugin).__mro__}
    classes = [
        member
        for module in sorted(modules & sys.modules.keys())
        for member in vars(sys.modules[module]).values()
        if isinstance(member, type) and dataclasses.is_dataclass(member)
    ]
    return [*FRAMEWORK_CLASSES, *classes]


def pack(value: Any, classes: Iterable[type], identity: str, owner: str) -> bytes:
    """`value` as the bytes of a safetensors file.

    Raises:
        UserError: for what cannot be held.
    """
    tree, tensors = encode(value, classes, owner)
    # under one key: several would be written in another order by each process
    return save(tensors, {KEY: json.dumps({"identity": identity, "tree": tree})})


def unpack(path: Path, classes: Iterable[type], wanted: str | None = None) -> tuple[str, Any]:
    """(identity, value) of a file of `pack`; of one with another identity than the wanted the value
    is None: it may hold what these classes never were.

    Raises:
        ValueError: also when it is damaged.
    """
    if file_size(path, CHECKPOINT_BYTES) == 0:  # before safetensors maps it
        raise ValueError(f"{path}: not a checkpoint (it is empty)")
    try:
        with safe_open(path, framework="pt") as file:
            header = json.loads((file.metadata() or {})[KEY])
            identity = str(header["identity"])
            if wanted not in (None, identity):
                return identity, None
            tensors = {name: file.get_tensor(name).clone() for name in file.keys()}  # noqa: SIM118
        value = decode(header["tree"], tensors, classes)
    except (SafetensorError, KeyError, TypeError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path}: not a checkpoint ({type(error).__name__}: {error})") from error
    return identity, value


def remove_checkpoints(run_dir: Path) -> None:
    """Remove all checkpoints of a run, which is complete or starts again, and no other file."""
    folder = run_dir / FOLDER
    with contextlib.suppress(OSError):
        for file in folder.rglob("*"):
            if NAME.fullmatch(file.name) or TEMPORARY.fullmatch(file.name):
                file.unlink()
        for path in (*folder.glob("*/"), folder):
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


class Checkpoints:
    """The checkpoints of one run; keeps states that a training offers after its steps.

    Args:
        run_dir: the run's folder.
        identity: of the run.
        plugins: the chosen ones, whose state is held.
        part: of the run, if it has several trainings.
    """

    def __init__(
        self, run_dir: Path, identity: str, plugins: Iterable[Any], part: str = ""
    ) -> None:
        self.folder, self.identity = run_dir / FOLDER / part, identity
        self.classes = state_classes(plugins)
        self._next = 0.0

    def begin(self, n_bytes: int) -> None:
        """The training begins.

        Args:
            n_bytes: about the size of the first, from which its cost is guessed.
        """
        self._next = time.perf_counter() + COST_TIMES * n_bytes / SLOW_DISK

    def newest(self, check: Check) -> TrainerState | None:
        """The last whole state of this run that passes `check`, which raises ValueError for one
        that its parts do not make; or None. Files of no use are removed."""
        for path in reversed(self._paths()):
            state = self._read(path, check)
            if state is not None:
                return state
            path.unlink()
        return None

    def due(self) -> bool:
        """Whether to keep one now."""
        return time.perf_counter() >= self._next

    def keep(self, state: TrainerState) -> None:
        """Keep `state`; its tensors are the training's own and change with the next step."""
        started = time.perf_counter()
        data = pack(state, self.classes, self.identity, "plugin state")
        if len(data) > CHECKPOINT_BYTES:
            LOG.warning(
                f"checkpoint: {len(data) / 2**30:.1f} GiB is more than the"
                f" {CHECKPOINT_BYTES / 2**30:.0f} GiB that may be read again, so none is kept: a"
                " training that is interrupted starts again"
            )
            self._next = math.inf
            return
        digest = hashlib.sha256(data).hexdigest()[:32]
        write_whole(self.folder / f"step-{state.step:09d}-{digest}.safetensors", data)
        for path in self._paths()[:-KEPT]:
            path.unlink()
        ended = time.perf_counter()
        self._next = ended + COST_TIMES * (ended - started)

    def _paths(self) -> list[Path]:
        """Oldest first."""
        return sorted(file for file in self.folder.glob("step-*") if NAME.fullmatch(file.name))

    def _read(self, path: Path, check: Check) -> TrainerState | None:
        """The state in `path`; None if it is damaged (with a warning) or another run's."""
        try:
            digest = hashlib.sha256(read_bytes(path, CHECKPOINT_BYTES)).hexdigest()[:32]
            if not path.stem.endswith(f"-{digest}"):
                raise ValueError("its content does not match the checksum in its name")
            identity, state = unpack(path, self.classes, self.identity)
            if identity != self.identity:
                return None
            if not isinstance(state, TrainerState):
                raise ValueError("it holds no training")
            check(state)
        except (ValueError, RecursionError) as error:
            LOG.warning("checkpoint %s is damaged and not used: %s", path.name, error)
            return None
        return state
