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
from framework.train.dose import REFUSED, Dose
from framework.train.gradient import Penalty
from framework.train.resume.training_state import Plugins, PluginState
from framework.types import PSEUDO, Gaussians, Render, View

LOG = logging.getLogger(__name__)
HALF = 0.5  # a method that acts on a smaller share of its occasions is told


@dataclass
class _Running:
    """A plugin with what it remembers."""

    group: str
    plugged: Plugged
    state: Any = None
    started: bool = False

    @property
    def idle(self) -> bool:
        """Whether it does nothing by design; a class of tests may have no word on it."""
        return bool(getattr(self.plugged.plugin, "idle", False))


class PluginsAtWork:
    """The plugins of one training. logged: what they logged since it was cleared. dose: all that
    they did is counted there."""

    def __init__(self, plugins: Plugins, conditions: Conditions, dose: Dose) -> None:
        self._conditions, self._dose = conditions, dose
        self._augment = _Running("augment", plugins.augment)
        self._reg = _Running("reg", plugins.reg)
        self._capacity = _Running("capacity", plugins.capacity)
        self.logged: dict[str, float] = {}
        self._acted = False  # whether the regularizer did, in this update
        for running in (self._augment, self._reg):
            if not running.idle:
                dose.open(f"{running.group}.asked")

    def pseudo_views(self, now: Moment) -> list[View]:
        """The pseudo views of an epoch that starts now, weighted and tagged."""
        context = self._context(self._augment, now)
        if context is None:
            return []
        plugged = self._augment.plugged
        result = plugged.plugin.pseudo_views(context, self._augment.state)
        views, self._augment.state = hooks.pseudo_views(plugged.plugin, result)
        if not self._augment.idle:
            self._dose.add("augment.asked", bool(views))
        for _ in views:
            self._dose.add("augment.views")
        return [
            replace(view, weight=view.weight * plugged.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def regularization(
        self, now: Moment, params: Gaussians
    ) -> tuple[Tensor | None, Penalty | None]:
        """What the regularizer makes of an update: factors [N] of the opacities, and its weighted
        loss term of a render of `params`; None where it leaves them as they are."""
        self._acted = False
        context = self._context(self._reg, now)
        if context is None:
            return None, None
        plugin: Any = self._reg.plugged.plugin
        penalty = functools.partial(self._penalty, self._in_loss(context, params))
        result = plugin.opacity_factors(context, self._reg.state)
        factors, self._reg.state = hooks.opacity_factors(plugin, result, len(params))
        if not self._reg.idle:
            self._dose.add("reg.asked")
        if factors is not None:
            self._dose.add("reg.dropped", float((factors < 1).double().mean()))
            self._note_act(bool((factors != 1).any()))
        return factors, penalty if plugin.weighted() else None

    def _in_loss(self, context: StepContext, params: Gaussians) -> StepContext:
        """What a loss term sees: the parameters themselves, where they are."""
        return replace(
            context, gaussians=params, background=context.background.to(params.means.device)
        )

    def edits(self, now: Moment, stats: StepStats) -> Edits | None:
        """How the capacity plugin wants the set to change after a step."""
        context = self._context(self._capacity, now)
        if context is None:
            return None
        plugin: Any = self._capacity.plugged.plugin
        result = plugin.update(context, self._capacity.state, _fetched(stats))
        edits, self._capacity.state = hooks.edits(plugin, result, len(now.gaussians))
        if edits is not None:
            self._dose.add("capacity.edits")
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
        """Warn of a method with little or no effect, which is its baseline or near it."""
        self._tell_of_pseudo_views()
        self._tell_of_regularizer()
        capacity = self._capacity.plugged.plugin
        if self._dose["capacity.edits"][0] == 0 and not capacity.idle:
            LOG.warning(
                f"capacity={capacity.name}: no Gaussian was added or removed in"
                f" {self._conditions.options.steps} steps, as with capacity=fixed; when it may is"
                f" set by its options, which --help capacity={capacity.name} tells"
            )

    def _tell_of_pseudo_views(self) -> None:
        asked, acted = self._dose["augment.asked"]
        name = _name(self._augment.plugged.plugin)
        if asked == 0 or acted >= HALF * asked:
            return
        if acted == 0:
            LOG.warning(
                f"augment={name}: no pseudo view in any of {asked}"
                " epochs that asked for one, so the method changed nothing; history.csv has what it"
                " logged, for instance the coverage that augment.min_coverage refuses"
            )
            return
        refused = self._dose[f"log.augment.{REFUSED}coverage"][0]
        LOG.warning(
            f"augment={name}: a pseudo view in only {acted:.0f} of {asked} epochs that asked for"
            f" one; {refused} covered less than augment.min_coverage"
        )

    def _tell_of_regularizer(self) -> None:
        asked, acted = self._dose["reg.asked"][0], self._dose["reg.acted"][0]
        plugin = self._reg.plugged.plugin
        if acted < HALF * asked:
            LOG.warning(
                f"reg={_name(plugin)}: changed only {acted} of the {asked} training steps between"
                f" reg.start={self._reg.plugged.start:g} and reg.stop={self._reg.plugged.stop:g}"
            )

    def _note_act(self, acted: bool) -> None:
        """Count that the regularizer acts in this update, once however many views it is of."""
        if acted and not self._acted:
            self._acted = True
            self._dose.add("reg.acted")

    def _all(self) -> tuple[_Running, ...]:
        return self._augment, self._reg, self._capacity

    def _context(self, running: _Running, now: Moment) -> StepContext | None:
        """What the plugin may see now; None while it is not active."""
        if not running.plugged.active(now.step / self._conditions.options.steps):
            return None
        log = functools.partial(self._log, running)
        context = step_context(self._conditions, now, running.group, log)
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
        self._note_act(term is not None)
        return 0.0 if term is None else plugged.weight * term

    def _log(self, running: _Running, name: str, value: float) -> None:
        """What a plugin logs: the last value is for the history, all of them for the dose, there
        without the plugin's own name."""
        self.logged[name] = value
        short = name.removeprefix(f"{_name(running.plugged.plugin)}_")
        self._dose.add(f"log.{running.group}.{short}", value)


def _fetched(stats: StepStats) -> StepStats:
    """On the CPU, where plugins work."""
    if stats.radii.device.type == "cpu":
        return stats
    return replace(stats, means2d_grad=stats.means2d_grad.cpu(), radii=stats.radii.cpu())


def _name(plugin: Any) -> str:
    """A class that was never registered, as in tests, has none."""
    return str(getattr(plugin, "name", type(plugin).__name__))
