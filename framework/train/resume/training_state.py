"""The state of a training: together with the configuration it determines every later bit.

Random streams need no state, as (seed, purpose, step) determines them. Real views are part of the
scene and are not stored; the pseudo views of an epoch are, since they were made at its start.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

from torch import Tensor

from framework import registry
from framework.records.run_files import HistoryRow
from framework.registry import ActivePlugin
from framework.train.dose import Tallies
from framework.train.optimizer import AdamState
from framework.types import Gaussians, View


@dataclass(frozen=True)
class Plugins:
    """The chosen plugins by the keys of their states: `augment`, `reg` and `capacity`, or
    `reg.NAME` and `capacity.NAME` where several of a group run."""

    each: Mapping[str, ActivePlugin]

    @classmethod
    def of(cls, choices: Mapping[str, Mapping[str, Any]]) -> Self:
        """Build the plugins of a run's configuration."""
        groups = [registry.build_all(group, choices[group]) for group in registry.GROUPS]
        return cls({key: chosen for group in groups for key, chosen in group.items()})

    def group(self, name: str) -> dict[str, ActivePlugin]:
        """The plugins of one group."""
        return {key: one for key, one in self.each.items() if key.partition(".")[0] == name}

    def shared(self, members: int) -> Self:
        """The plugins of one of so many trainings whose Gaussians are joined."""
        capacities = {
            key: replace(one, plugin=one.plugin.shared(members))
            for key, one in self.group("capacity").items()
        }
        return replace(self, each={**self.each, **capacities})

    def always(self) -> Self:
        """The same plugins, active over the whole training."""
        each = {key: replace(one, start=0.0, stop=1.0) for key, one in self.each.items()}
        return replace(self, each=each)

    @property
    def second_field(self) -> bool:
        """Whether a plugin compares the Gaussians with a second set."""
        return any(one.plugin.second_field for one in self.each.values())

    @property
    def second_drawn(self) -> bool:
        """Whether the second set starts from another draw."""
        return any(one.plugin.second_drawn for one in self.each.values())


@dataclass(frozen=True)
class Trained:
    """The result of a training.

    Attributes:
        background: [3], of renders for evaluation.
        wall_s, cpu_s: of the training without evaluations.
        resumed: how often it was resumed.
        dose: see `framework.train.dose`.
    """

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
    """A set of Gaussians in training.

    Attributes:
        version: as in `StepContext`.
        plugins: by key.
    """

    version: int
    gaussians: Gaussians
    adam: AdamState
    plugins: Mapping[str, PluginState]


@dataclass(frozen=True)
class TrainerState:
    """A training between two steps.

    Attributes:
        step: finished steps.
        left: real views of the epoch that are not yet trained on.
        logged: since the last row of `history`.
        psnr: the last one measured.
        wall_s, cpu_s: so far, without evaluations.
        second: state of the second field, if there is one.
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
