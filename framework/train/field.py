"""A set of Gaussians in training, with all that acts on it.

A training has one. Methods that compare two, as CoR-GS (Zhang et al. 2024), train a second beside
it: on the same views, with draws, moments and plugins of its own. Only the first is evaluated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from torch import Tensor

from framework.backends import Rasterizer
from framework.plugin import Edits
from framework.train.edits import apply_edits, rows_after
from framework.train.optimizer import Optimizer
from framework.train.plugin_calls import PluginCalls
from framework.train.resume.training_state import FieldState
from framework.train.torch_adam import optimizer_of
from framework.types import Gaussians


@dataclass
class Field:
    """params: leaf tensors that the optimizer changes in place, on the rasterizer's device.
    version: changes with their number or order."""

    params: Gaussians
    optimizer: Optimizer
    plugins: PluginCalls
    rasterizer: Rasterizer
    version: int = 0

    @staticmethod
    def of(gaussians: Gaussians, plugins: PluginCalls, rasterizer: Rasterizer) -> Field:
        """A field that starts from a copy of `gaussians`."""
        params = gaussians.clone().to(rasterizer.device).leaves()
        return Field(params, optimizer_of(rasterizer, params), plugins, rasterizer)

    def edit(self, edits: Edits, where: str) -> Tensor | None:
        """Apply a capacity's `Edits`, parameters and moments together. Where rows changed: of every
        row the one it was, -1 for an appended one."""
        rows = rows_after(self.params, edits) if edits.changes_the_rows else None
        edited = apply_edits(self.params.detach(), self.optimizer, edits, where)
        self.params = edited.to(self.rasterizer.device).leaves()
        self.version += int(edits.changes_the_rows)
        return rows

    def state(self) -> FieldState:
        """What a checkpoint holds; its tensors are the field's own."""
        kept = self.plugins.states()
        gaussians = self.params.detach().to("cpu")
        return FieldState(self.version, gaussians, self.optimizer.state(), kept)

    def take_up(self, state: FieldState, logged: Mapping[str, float] | None = None) -> None:
        """Go on from what a checkpoint held."""
        self.version = state.version
        self.params = state.gaussians.to(self.rasterizer.device).leaves()
        self.optimizer.load(state.adam)
        self.plugins.load(state.plugins, logged)
