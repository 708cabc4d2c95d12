"""The three plugins of a training at work: when each is asked, with what, and what it remembers.

A plugin is asked only while its framework keys `start` and `stop` say so; its state is made when it
is first active. What a hook gives is checked (`hooks`) before the trainer uses it.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from torch import Tensor

from framework.plugin import Edits, StepContext, StepStats
from framework.registry import Plugged
from framework.train import hooks
from framework.train.context import Conditions, Moment, step_context
from framework.train.gradient import Penalty
from framework.train.resume.training_state import Plugins, PluginState
from framework.types import PSEUDO, Gaussians, Render, View

LOG = logging.getLogger(__name__)


@dataclass
class _Running:
    """A plugin with what it remembers."""

    group: str
    plugged: Plugged
    state: Any = None
    started: bool = False


class PluginsAtWork:
    """The plugins of one training. logged: what they logged since it was cleared."""

    def __init__(self, plugins: Plugins, conditions: Conditions) -> None:
        self._conditions = conditions
        self._augment = _Running("augment", plugins.augment)
        self._reg = _Running("reg", plugins.reg)
        self._capacity = _Running("capacity", plugins.capacity)
        self.logged: dict[str, float] = {}
        self._asked, self._given = 0, 0  # epochs that asked for pseudo views, what they got
        self._edits = 0  # of the set, by the capacity plugin

    def pseudo_views(self, now: Moment) -> list[View]:
        """The pseudo views of an epoch that starts now, weighted and tagged."""
        context = self._context(self._augment, now)
        if context is None:
            return []
        plugged = self._augment.plugged
        result = plugged.plugin.pseudo_views(context, self._augment.state)
        views, self._augment.state = hooks.pseudo_views(plugged.plugin, result)
        self._asked, self._given = self._asked + 1, self._given + len(views)
        return [
            replace(view, weight=view.weight * plugged.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def regularization(
        self, now: Moment, params: Gaussians
    ) -> tuple[Tensor | None, Penalty | None]:
        """What the regularizer makes of a step: factors [N] of the opacities, and its weighted loss
        term of a render of `params`; None where it leaves them as they are."""
        context = self._context(self._reg, now)
        if context is None:
            return None, None
        plugin: Any = self._reg.plugged.plugin
        penalty = functools.partial(self._penalty, replace(context, gaussians=params))
        result = plugin.opacity_factors(context, self._reg.state)
        factors, self._reg.state = hooks.opacity_factors(plugin, result, len(params))
        return factors, penalty if plugin.weighted() else None

    def edits(self, now: Moment, stats: StepStats) -> Edits | None:
        """How the capacity plugin wants the set to change after a step."""
        context = self._context(self._capacity, now)
        if context is None:
            return None
        plugin: Any = self._capacity.plugged.plugin
        result = plugin.update(context, self._capacity.state, stats)
        edits, self._capacity.state = hooks.edits(plugin, result, len(now.gaussians))
        self._edits += edits is not None
        return edits

    def kept(self) -> dict[str, PluginState]:
        """What a checkpoint holds of the plugins, by group."""
        return {r.group: PluginState(r.started, r.state) for r in self._all()}

    def take_up(self, kept: Mapping[str, PluginState], logged: Mapping[str, float]) -> None:
        """Go on from what a checkpoint held."""
        for running in self._all():
            own = kept[running.group]
            running.started, running.state = own.started, own.value
        self.logged.update(logged)

    def tell_what_did_nothing(self) -> None:
        """Warn of a method without any effect, which is its baseline."""
        augment, capacity = self._augment.plugged.plugin, self._capacity.plugged.plugin
        if self._asked > 0 and self._given == 0 and not augment.idle:
            LOG.warning(
                f"augment={augment.name}: no pseudo view in any of {self._asked}"
                " epochs that asked for one, so the method changed nothing; history.csv has what it"
                " logged, for instance the coverage that augment.min_coverage refuses"
            )
        if self._edits == 0 and not capacity.idle:
            LOG.warning(
                f"capacity={capacity.name}: no Gaussian was added or removed in"
                f" {self._conditions.options.steps} steps, as with capacity=fixed; when it may is"
                f" set by its options, which --help capacity={capacity.name} tells"
            )

    def _all(self) -> tuple[_Running, ...]:
        return self._augment, self._reg, self._capacity

    def _context(self, running: _Running, now: Moment) -> StepContext | None:
        """What the plugin may see now; None while it is not active."""
        if not running.plugged.active(now.step / self._conditions.options.steps):
            return None
        context = step_context(self._conditions, now, running.group, self.logged.__setitem__)
        if not running.started:
            running.started = True
            running.state = running.plugged.plugin.init_state(context)
        return context

    def _penalty(self, context: StepContext, view: View, render: Render) -> Tensor | float:
        """The regularizer's weighted loss term; 0 without one."""
        plugged = self._reg.plugged
        term = hooks.loss_term(
            plugged.plugin, plugged.plugin.loss(context, self._reg.state, view, render)
        )
        return 0.0 if term is None else plugged.weight * term
