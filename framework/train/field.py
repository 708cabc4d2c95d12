"""A set of Gaussians in training, with its optimizer and plugins.

A training has one field. Methods that compare two, such as CoR-GS (Zhang et al. 2024), train a
second on the same views, with separate draws, moments and plugins. Only the first is evaluated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from framework.backends import Rasterizer
from framework.errors import require
from framework.plugin import Edits
from framework.train.guard import check_appended
from framework.train.optimizer import Optimizer
from framework.train.plugin_calls import PluginCalls
from framework.train.resume.training_state import FieldState
from framework.train.torch_adam import optimizer_of
from framework.types import Gaussians, edited


@dataclass
class Field:
    """A set of Gaussians in training.

    Attributes:
        params: leaf tensors on the rasterizer's device, which the optimizer changes in place.
        version: changes with their number or order.
    """

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
        """Apply a capacity's edits to parameters and moments.

        Returns:
            If rows changed, for every row its previous one, -1 for an appended one; else None.
        """
        rows = rows_after(self.params, edits) if edits.changes_the_rows else None
        changed = apply_edits(self.params.detach(), self.optimizer, edits, where)
        self.params = changed.to(self.rasterizer.device).leaves()
        self.version += int(edits.changes_the_rows)
        return rows

    def state(self) -> FieldState:
        """The state for a checkpoint; shares the field's tensors."""
        kept = self.plugins.states()
        gaussians = self.params.detach().to("cpu")
        return FieldState(self.version, gaussians, self.optimizer.state(), kept)

    def load(self, state: FieldState, logged: Mapping[str, float] | None = None) -> None:
        """Continue from the state of a checkpoint."""
        self.version = state.version
        self.params = state.gaussians.to(self.rasterizer.device).leaves()
        self.optimizer.load(state.adam)
        self.plugins.load(state.plugins, logged)


def apply_edits(params: Gaussians, optimizer: Optimizer, edits: Edits, where: str) -> Gaussians:
    """Return the edited set and edit the optimizer's moments; new values keep their moments.

    Args:
        params: detached.
        where: the place, for messages.

    Raises:
        UserError: no Gaussian is left.
        Diverged: an appended Gaussian is not finite.
    """
    edits = _placed(edits, params.means.device)
    if edits.sh0 is not None:
        params = params.replace(sh0=edits.sh0)
    params = params.replace(**edits.values)
    if edits.changes_the_rows:
        params = edited(params, edits.keep, edits.bands, edits.append)
        optimizer.edit(edits.keep, edits.bands, edits.append)
    if edits.opacity_ceiling is not None:
        ceiling = math.log(edits.opacity_ceiling / (1 - edits.opacity_ceiling))
        params = params.replace(opacity_logits=params.opacity_logits.clamp(max=ceiling))
        optimizer.zero("opacity_logits")
    require(
        len(params) > 0,
        f"{where}: the capacity plugin removed every Gaussian; soften its pruning (of adc:"
        " capacity.min_opacity), choose capacity=fixed, or start from more Gaussians",
    )
    if edits.append is not None:
        check_appended(edits.append, where)
    return params


def _placed(edits: Edits, device: torch.device) -> Edits:
    """The edits on the device of the parameters; plugins work on the CPU."""
    if device.type == "cpu":
        return edits
    parts = {name: getattr(edits, name) for name in ("keep", "append", "bands", "sh0")}
    there = {k: part.to(device) for k, part in parts.items() if part is not None}
    return replace(edits, **there, values={k: v.to(device) for k, v in edits.values.items()})


def rows_after(params: Gaussians, edits: Edits) -> Tensor:
    """[N'] int64: for every Gaussian after the edits its previous row, -1 for an appended one."""
    rows = torch.arange(len(params), dtype=torch.float64)
    marked, new = params.detach().to("cpu").replace(means=rows[:, None].expand(-1, 3)), edits.append
    if new is not None:
        new = new.replace(means=torch.full((len(new), 3), -1.0, dtype=torch.float64))
    return edited(marked, edits.keep, edits.bands, new).means[:, 0].long()
