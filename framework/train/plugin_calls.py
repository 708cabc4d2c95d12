"""The plugins of a training at work: when each is asked, with what, and what it remembers.

A plugin is asked only while its framework keys `start` and `stop` say so; its state is made when it
is first active. What a hook gives is checked (`hooks`) before the trainer uses it.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.errors import UserError, plugin_call
from framework.plugin import (
    Edits,
    GradientAt,
    Regularizer,
    StepContext,
    StepStats,
    SubStep,
)
from framework.registry import Plugged
from framework.train import hooks
from framework.train.context import CPU, Conditions, Moment, on_cpu, step_context
from framework.train.descent import Regularization
from framework.train.dose import REFUSED, Dose
from framework.train.gradient import Penalty
from framework.train.resume.training_state import Plugins, PluginState
from framework.types import PSEUDO, Gaussians, Render, View

LOG = logging.getLogger(__name__)
HOOKS = ("opacity_factors", "loss", "gradient", "substeps", "evaluated")
HALF = 0.5  # a method that acts on a smaller share of its occasions is told


@dataclass
class _Running:
    """A plugin with what it remembers. owner: its group's name, or of several plugins of a group
    `group.name`. draws: in whose name it draws; the first of several draws as it would alone."""

    owner: str
    draws: str
    plugged: Plugged
    state: Any = None
    started: bool = False
    acted: bool = False  # in this update

    @property
    def idle(self) -> bool:
        """Whether it does nothing by design; a class of tests may have no word on it."""
        return bool(getattr(self.plugged.plugin, "idle", False))

    @property
    def asked(self) -> bool:
        """Whether it is asked about updates: all but what does nothing by design and has no hook,
        as `reg=none`."""
        return not self.idle or any(map(self.has, HOOKS))

    def has(self, hook: str) -> bool:
        """Whether its class has this hook of a `Regularizer`, and not just the base class' own."""
        own = getattr(type(self.plugged.plugin), hook, None)
        return own is not None and own is not getattr(Regularizer, hook)


class PluginsAtWork:
    """The plugins of one field of a training. logged: what they logged since it was cleared. dose:
    all that they did is counted there."""

    def __init__(self, plugins: Plugins, conditions: Conditions, dose: Dose) -> None:
        self._conditions, self._dose = conditions, dose
        (self._augment,) = _running("augment", plugins.augment)
        self._regs = _running("reg", plugins.reg)
        self._capacities = _running("capacity", plugins.capacity)
        self.logged: dict[str, float] = {}
        self._refused = ""  # why the augmenter made no view in this epoch, by its last word
        self.gradients = tuple(
            {
                name: None
                for running in self._capacities
                for name in hooks.wanted(running.plugged.plugin)
            }
        )  # parameters whose gradient a capacity looks at
        with plugin_call("capacity: wants_absolute"):
            self.absolute = any(r.plugged.plugin.wants_absolute() for r in self._capacities)
        for running in (self._augment, *self._regs):
            if not running.idle:
                dose.open(f"{running.owner}.asked")

    def pseudo_views(self, now: Moment) -> list[View]:
        """The pseudo views of an epoch that starts now, weighted and tagged."""
        context = self._context(self._augment, now)
        if context is None:
            return []
        plugged, self._refused = self._augment.plugged, ""
        with hooks.at_work(
            "augment", plugged.plugin, "pseudo_views", now.step, now.gaussians, now.other
        ):
            result = plugged.plugin.pseudo_views(context, self._augment.state)
        views, self._augment.state = hooks.pseudo_views(plugged.plugin, result)
        if not self._augment.idle:
            self._dose.add("augment.asked", bool(views))
        if self._refused and not views:
            self._dose.add(f"log.augment.{self._refused}", 1.0)
        for _ in views:
            self._dose.add("augment.views")
        return [
            replace(view, weight=view.weight * plugged.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def substeps(self, now: Moment, params: Gaussians, view: View) -> Iterator[SubStep]:
        """The losses that regularizers take steps of their own down, weighted."""
        for running in self._regs:
            if not running.has("substeps"):
                continue
            context = self._context(running, now)
            if context is None:
                continue
            plugged, running.acted = running.plugged, False
            inside = replace(context, gaussians=on_cpu(params))
            for loss, names in hooks.sub_steps(plugged.plugin, inside, running.state, view):
                self._dose.add("substeps")
                self._note_act(running, True)
                yield plugged.weight * loss, names

    def regularization(self, now: Moment, params: Gaussians) -> Regularization:
        """What the regularizers make of an update of `params`."""
        factors: Tensor | None = None
        asked: list[tuple[_Running, StepContext]] = []
        for running in self._regs:
            context = self._context(running, now) if running.asked else None
            if context is None:
                continue
            asked.append((running, context))
            if now.turn > 0 or not running.has("substeps"):  # else these began the update
                running.acted = False
            own = self._factors(running, context, len(params))
            if own is not None:
                factors = own if factors is None else factors * own
        weighted = [pair for pair in asked if pair[0].has("loss")]
        mixing = [pair for pair in asked if pair[0].has("gradient")]
        penalty = functools.partial(self._penalties, weighted) if weighted else None
        return Regularization(
            factors, penalty, functools.partial(self._mixed, mixing) if mixing else None
        )

    def evaluated(self, now: Moment, gaussians: Gaussians) -> Gaussians:
        """What is evaluated and kept in the place of `gaussians`, those of `now` on the CPU: by
        regularizers that acted in its step, the last that was taken."""
        for running in self._regs:
            active = running.plugged.active(now.step / self._conditions.options.steps)
            if running.has("evaluated") and running.started and active:
                plugin: Any = running.plugged.plugin
                context = step_context(self._conditions, now, running.draws, _unheard)
                with hooks.at_work("reg", plugin, "evaluated", now.step, gaussians):
                    found = plugin.evaluated(context, gaussians, running.state)
                gaussians = hooks.evaluated(plugin, found, gaussians.shN.shape[1])
        return gaussians

    def edits(
        self,
        now: Moment,
        stats: StepStats,
        apply: Callable[[Edits], tuple[Gaussians, Tensor | None]],
    ) -> None:
        """Let the capacities change the set after a step, each what those before it left.

        apply(edits): the new Gaussians, and which row each was before, None where rows stay.
        """
        if stats.radii.device.type != CPU:  # where plugins work
            stats = stats.map(Tensor.cpu)
        for running in self._capacities:
            context = self._context(running, now)
            if context is None:
                continue
            plugin: Any = running.plugged.plugin
            with hooks.at_work("capacity", plugin, "update", now.step, now.gaussians, now.other):
                result = plugin.update(context, running.state, stats)
            edits, running.state = hooks.edits(plugin, result, now.gaussians)
            if edits is None:
                continue
            if edits.changes_something:
                self._dose.add(f"{running.owner}.edits")
            gaussians, rows = apply(edits)
            if len(self._capacities) == 1:
                continue
            now = replace(now, gaussians=gaussians)
            if rows is not None:
                now, stats = replace(now, version=now.version + 1), _followed(stats, rows)
                self._follow(running, rows)

    def kept(self) -> dict[str, PluginState]:
        """What a checkpoint holds of the plugins, by their keys."""
        return {r.owner: PluginState(r.started, r.state) for r in self._all()}

    def take_up(
        self, kept: Mapping[str, PluginState], logged: Mapping[str, float] | None = None
    ) -> None:
        """Go on from what a checkpoint held."""
        for running in self._all():
            own = kept[running.owner]
            running.started, running.state = own.started, own.value
        self.logged.update(logged or {})

    def tell_what_did_nothing(self) -> None:
        """Warn of a method with little or no effect, which is its baseline or near it."""
        self._tell_of_pseudo_views()
        for running in self._regs:
            self._tell_of_regularizer(running)
        for running in self._capacities:
            self._tell_of_capacity(running)

    def _tell_of_capacity(self, running: _Running) -> None:
        capacity = running.plugged.plugin
        if capacity.second_field:  # what it does there is not counted here
            if not any(r.plugged.plugin.second_field for r in self._regs):
                LOG.warning(
                    f"capacity={_name(capacity)}: changes the second field alone, and no"
                    " regularizer compares the two, so it changed nothing; add one that does, as"
                    " reg=co_register"
                )
            return
        if self._dose[f"{running.owner}.edits"][0] == 0 and not running.idle:
            LOG.warning(
                f"capacity={_name(capacity)}: changed no Gaussian in"
                f" {self._conditions.options.steps} steps, as capacity=fixed; when it may is"
                f" set by its options, which --help capacity={_name(capacity)} tells"
            )

    def _tell_of_pseudo_views(self) -> None:
        asked, acted = self._dose["augment.asked"]
        name = _name(self._augment.plugged.plugin)
        if asked == 0 and not self._augment.idle:
            LOG.warning(
                f"augment={name}: was asked in no epoch, so the method changed nothing: none of the"
                f" {len(self._conditions.training.views)} photos' epochs begins between"
                f" {_span(self._augment)} of {self._conditions.options.steps} steps; take more"
                " steps, or another augment.start"
            )
        if acted >= HALF * asked:
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

    def _tell_of_regularizer(self, running: _Running) -> None:
        asked, acted = (self._dose[f"{running.owner}.{what}"][0] for what in ("asked", "acted"))
        name = _name(running.plugged.plugin)
        if asked == 0 and not running.idle:
            LOG.warning(
                f"reg={name}: was asked in none of {self._conditions.options.steps} steps, so the"
                f" method changed nothing: no step lies between {_span(running)}"
            )
        if acted < HALF * asked:
            LOG.warning(
                f"reg={name}: changed only {acted} of the {asked} training steps between"
                f" {_span(running)}"
            )

    def _note_act(self, running: _Running, acted: bool) -> None:
        """Count that a plugin acts in this update, once however many views it is of."""
        if acted and not running.acted:
            running.acted = True
            self._dose.add(f"{running.owner}.acted")

    def _all(self) -> tuple[_Running, ...]:
        return self._augment, *self._regs, *self._capacities

    def _context(self, running: _Running, now: Moment) -> StepContext | None:
        """What the plugin may see now; None while it is not active."""
        if not running.plugged.active(now.step / self._conditions.options.steps):
            return None
        log = functools.partial(self._log, running)
        context = step_context(self._conditions, now, running.draws, log)
        if not running.started:
            running.started = True
            plugin: Any = running.plugged.plugin
            group = running.owner.partition(".")[0]
            with hooks.at_work(group, plugin, "init_state", now.step, now.gaussians, now.other):
                running.state = plugin.init_state(context)
        return context

    def _factors(self, running: _Running, context: StepContext, n: int) -> Tensor | None:
        """What one regularizer multiplies opacities by, [N] or None."""
        plugin: Any = running.plugged.plugin
        if not running.idle:
            self._dose.add(f"{running.owner}.asked")
        if not running.has("opacity_factors"):
            return None
        with hooks.at_work(
            "reg", plugin, "opacity_factors", context.step, context.gaussians, context.other
        ):
            result = plugin.opacity_factors(context, running.state)
        factors, running.state = hooks.opacity_factors(plugin, result, n)
        if factors is not None:
            values = factors.detach().numpy()  # which counts faster than torch
            if plugin.drops:
                self._dose.add(f"{running.owner}.dropped", np.count_nonzero(values < 1) / n)
            self._note_act(running, bool((values != 1).any()))
        return factors

    def _penalties(
        self, asked: Sequence[tuple[_Running, StepContext]], params: Gaussians
    ) -> Penalty:
        """What the regularizers add to the loss on a render of `params`; both may be on another
        device, plugins see them on the CPU."""
        seen = on_cpu(params)
        inside = [(running, replace(context, gaussians=seen)) for running, context in asked]

        def penalty(view: View, render: Render) -> Tensor | float:
            total: Tensor | float = 0.0
            fetched = render.to(CPU)
            for running, context in inside:
                total = total + self._penalty(running, context, view, fetched)
            return total.to(render.rgb.device) if isinstance(total, Tensor) else total

        return penalty

    def _penalty(
        self, running: _Running, context: StepContext, view: View, render: Render
    ) -> Tensor | float:
        """A regularizer's weighted loss term; 0 without one."""
        plugged = running.plugged
        plugin = plugged.plugin
        with hooks.at_work(
            "reg", plugin, "loss", context.step, context.gaussians, context.other, render
        ):
            found = plugin.loss(context, running.state, view, render)
        term = hooks.loss_term(plugin, found)
        self._note_act(running, term is not None)
        return 0.0 if term is None else plugged.weight * term

    def _mixed(
        self,
        asked: Sequence[tuple[_Running, StepContext]],
        found: Mapping[str, Tensor],
        at: GradientAt,
    ) -> Mapping[str, Tensor]:
        """The gradient that the optimizer gets, as one regularizer after the other changes it: each
        sees those before it in what it is given, and in what it asks for elsewhere."""
        device = found["means"].device

        def through(
            count: int, gaussians: Gaussians | None, found: Mapping[str, Tensor]
        ) -> Mapping[str, Tensor]:
            """`found` as the first `count` leave it; gaussians: elsewhere, None for the step's own
            place, where it is noted who acted."""
            for before, (running, context) in enumerate(asked[:count]):
                inside = context
                if gaussians is not None:
                    inside = replace(context, gaussians=gaussians, log=_unheard)
                there = functools.partial(elsewhere, before)
                plugin = running.plugged.plugin
                with hooks.at_work("reg", plugin, "gradient", context.step, inside.gaussians):
                    own = plugin.gradient(inside, running.state, found, there)
                if gaussians is None:
                    self._note_act(running, own is not None)
                found = found if own is None else hooks.gradient(plugin, own, found)
            return found

        def elsewhere(count: int, gaussians: Gaussians) -> Mapping[str, Tensor]:
            return through(count, gaussians, _brought(at(gaussians.to(device)), CPU))

        return _brought(through(len(asked), None, _brought(found, CPU)), device)

    def _follow(self, editor: _Running, rows: Tensor) -> None:
        """Tell the other capacities that one changed the set."""
        for running in self._capacities:
            if running is not editor and running.started:
                plugin = running.plugged.plugin
                with plugin_call(f"capacity={_name(plugin)}: followed"):
                    running.state = plugin.followed(running.state, rows)

    def _log(self, running: _Running, name: str, value: float) -> None:
        """What a plugin logs: the last value is for the history, all of them for the dose, there
        without the plugin's own name."""
        if not isinstance(name, str) or not name.isprintable():
            raise UserError(f"ctx.log: expected a name in one line, got {name!r:.40}")
        if not isinstance(value, int | float | np.number):  # a tensor of one value
            value = float(value)
        self.logged[name] = value
        short = name.removeprefix(f"{_name(running.plugged.plugin)}_")
        if running is self._augment and short.startswith(REFUSED):
            self._refused = short  # an epoch counts once, whatever was tried in it
            return
        self._dose.add(f"log.{running.owner}.{short}", value)


def _running(group: str, plugged: Plugged) -> tuple[_Running, ...]:
    """The plugins of a group at their start."""
    each = plugged.each(group).items()
    return tuple(_Running(key, key if i else group, one) for i, (key, one) in enumerate(each))


def _unheard(name: str, value: float) -> None:
    """What a plugin logs where it is asked a second time in a step, or in an evaluation."""


def _followed(stats: StepStats, rows: Tensor) -> StepStats:
    """The measures of a step on the Gaussians that a capacity made of those measured; of new ones
    nothing was measured, and nobody dropped them. rows: which each was, -1 for a new one."""
    old, there = rows.clamp(min=0), rows >= 0

    def follow(values: Tensor) -> Tensor:
        return values[old] * there.view(-1, *[1] * (values.dim() - 1))

    followed = stats.map(follow)
    if followed.factors is None:
        return followed
    return replace(followed, factors=torch.where(there, followed.factors, 1.0))


def _brought(tensors: Mapping[str, Tensor], device: str | torch.device) -> Mapping[str, Tensor]:
    """What is there already is not copied."""
    return {name: tensor.to(device) for name, tensor in tensors.items()}


def _span(running: _Running) -> str:
    start, stop = running.plugged.start, running.plugged.stop
    return f"{running.owner}.start={start:g} and {running.owner}.stop={stop:g}"


def _name(plugin: Any) -> str:
    """A class that was never registered, as in tests, has none."""
    return str(getattr(plugin, "name", type(plugin).__name__))
