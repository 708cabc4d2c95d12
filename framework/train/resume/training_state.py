"""All that a training needs to go on: with it and the configuration every later bit is fixed.

Random draws need nothing here: a stream is fixed by (seed, purpose, step). Real views are part of
the scene and are not repeated; an epoch's pseudo views are, since they were made at its start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from torch import Tensor

from framework import registry
from framework.records.run_files import HistoryRow
from framework.registry import Plugged
from framework.train.dose import Tallies
from framework.train.optimizer import AdamState
from framework.types import Gaussians, View


@dataclass(frozen=True)
class Plugins:
    """The chosen plugins with their framework keys, of `reg` and `capacity` perhaps several."""

    augment: Plugged
    reg: Plugged
    capacity: Plugged

    @classmethod
    def of(cls, choices: Mapping[str, Mapping[str, Any]]) -> Self:
        """Those of `choices`: of each group its choice, as in a run's configuration."""
        return cls(*(registry.build(group, choices[group]) for group in registry.GROUPS))

    def each(self) -> dict[str, Plugged]:
        """Every single one, by the key of its state."""
        groups = (("augment", self.augment), ("reg", self.reg), ("capacity", self.capacity))
        return {key: one for name, plugged in groups for key, one in plugged.each(name).items()}

    @property
    def second_field(self) -> bool:
        """Whether any of them compares the Gaussians with a second set."""
        return any(one.plugin.second_field for one in self.each().values())

    @property
    def second_drawn(self) -> bool:
        """Whether that set begins with a draw of its own."""
        return any(one.plugin.second_drawn for one in self.each().values())


@dataclass(frozen=True)
class Trained:
    """What a training gives. background: [3], what renders for evaluation stand on. wall_s, cpu_s:
    of the training without evaluations, all its parts together. resumed: how often it was taken up
    again from a kept state. dose: see `framework.train.dose`."""

    gaussians: Gaussians
    background: Tensor
    sh_degree: int
    history: tuple[HistoryRow, ...]
    wall_s: float
    cpu_s: float
    resumed: int
    dose: Tallies = field(default_factory=dict)


@dataclass(frozen=True)
class PluginState:
    """A plugin's own state, and whether it was made yet."""

    started: bool
    value: Any


@dataclass(frozen=True)
class FieldState:
    """A set of Gaussians in training. version: as in `StepContext`. plugins: by key."""

    version: int
    gaussians: Gaussians
    adam: AdamState
    plugins: Mapping[str, PluginState]


@dataclass(frozen=True)
class TrainerState:
    """A training between two steps.

    step: finished steps. left: how many of the epoch's real views are still to be trained on.
    pseudo: the epoch's pseudo views. logged: since the last row of `history`. field: what is
    trained; second: the field beside it, where a plugin wants one.
    dose: of the methods so far. psnr: the last one measured. wall_s, cpu_s: of the training so far,
    without evaluations. resumed: how often it was taken up again.
    """

    step: int
    epoch: int
    left: int
    field: FieldState
    pseudo: tuple[View, ...]
    history: tuple[HistoryRow, ...]
    logged: Mapping[str, float]
    dose: Tallies
    psnr: float | None
    wall_s: float
    cpu_s: float
    resumed: int
    second: FieldState | None = None


class Keeper(Protocol):
    """Who keeps the states that a training offers after its steps."""

    def due(self) -> bool:
        """Whether to keep one now."""

    def keep(self, state: TrainerState) -> None:
        """Keep `state`; its tensors are the training's own and change with the next step."""
