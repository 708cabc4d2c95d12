"""Calls the plugins of a training: when each hook is called, with which context and state.

A plugin is called only between its framework keys `start` and `stop`. Its state is initialised at
the first call. The trainer uses a result only after `hooks` has checked it.
"""

import functools
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.errors import UserError, plugin_call
from framework.plugin import Edits, GradientAt, Regularizer, StepContext, StepStats, SubStep
from framework.registry import ActivePlugin
from framework.train import hooks
from framework.train.context import CPU, Conditions, Moment, on_cpu, step_context
from framework.train.descent import Gradients, Regularization
from framework.train.dose import NONE, REFUSED, Dose
from framework.train.gradient import Penalty
from framework.train.resume.training_state import Plugins, PluginState
from framework.types import PSEUDO, Gaussians, Render, View

LOG = logging.getLogger(__name__)
REGULARIZER_HOOKS = ("opacity_factors", "loss", "gradient", "substeps", "evaluated")
HALF = 0.5  # warn about a method that acts on a smaller share of its calls


@dataclass
class RunningPlugin:
    """A plugin in a training, with its state.

    Attributes:
        key: of its state: its group, or `group.name` where several plugins of a group run.
        rng_key: names its random streams. The first plugin uses the group's name.
        started: whether `state` was initialised.
        acted: whether it acted in the current update.
    """

    key: str
    rng_key: str
    chosen: ActivePlugin
    state: Any = None
    started: bool = False
    acted: bool = False

    @property
    def plugin(self) -> Any:
        return self.chosen.plugin

    @property
    def idle(self) -> bool:
        """Whether the plugin is a deliberate no-op."""
        return bool(self.plugin.idle)

    @property
    def called_in_updates(self) -> bool:
        """Whether updates call it: False for a no-op without a hook, such as `reg=none`."""
        return not self.idle or any(map(self.has, REGULARIZER_HOOKS))

    def has(self, hook: str) -> bool:
        """Whether the class overrides this hook of `Regularizer`."""
        return getattr(type(self.plugin), hook, None) not in (None, getattr(Regularizer, hook))

    def call(self, hook: str, ctx: StepContext, *arguments: Any) -> Any:
        """Call a hook with a context it may only read.

        Raises:
            UserError: for every failure.
        """
        renders = [value for value in arguments if isinstance(value, Render)]
        with hooks.checked_call(self.plugin, hook, ctx.step, ctx.gaussians, ctx.other, *renders):
            return getattr(self.plugin, hook)(ctx, *arguments)


class PluginCalls:
    """The plugins of one field of a training.

    Attributes:
        logged: values that the plugins logged since the last clearing.
        gradients: parameters whose gradient a capacity requests.
        absolute: whether a capacity requests absolute gradients.
    """

    def __init__(self, plugins: Plugins, conditions: Conditions, dose: Dose) -> None:
        self._conditions, self._dose = conditions, dose
        (self._augment,) = _running(plugins, "augment")
        self._regs = _running(plugins, "reg")
        self._capacities = _running(plugins, "capacity")
        self.logged: dict[str, float] = {}
        self._refused = ""  # the reason logged last for making no view in this epoch
        requested = [hooks.requested_gradients(r.plugin) for r in self._capacities]
        self.gradients = tuple(dict.fromkeys(name for names in requested for name in names))
        with plugin_call("capacity: wants_absolute"):
            self.absolute = any(r.plugin.wants_absolute() for r in self._capacities)
        for running in (self._augment, *self._regs):
            if not running.idle:
                dose.setdefault(f"{running.key}.asked", NONE)

    def pseudo_views(self, now: Moment) -> list[View]:
        """Return the pseudo views of the epoch that starts, weighted and tagged."""
        augment = self._augment
        context = self._context(augment, now)
        if context is None:
            return []
        self._refused = ""
        result = augment.call("pseudo_views", context, augment.state)
        views, augment.state = hooks.pseudo_views(augment.plugin, result)
        if not augment.idle:
            self._dose.add("augment.asked", bool(views))
        if self._refused and not views:
            self._dose.add(f"log.augment.{self._refused}", 1.0)
        for _ in views:
            self._dose.add("augment.views")
        return [
            replace(view, weight=view.weight * augment.chosen.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def substeps(self, now: Moment, params: Gaussians, view: View) -> Iterator[SubStep]:
        """Yield the weighted losses for which regularizers request optimizer steps."""
        for running in self._regs:
            if not running.has("substeps"):
                continue
            context = self._context(running, now)
            if context is None:
                continue
            running.acted = False
            context = replace(context, gaussians=on_cpu(params))
            for loss, names in hooks.sub_steps(running.plugin, context, running.state, view):
                self._dose.add("substeps")
                self._count_act(running, True)
                yield running.chosen.weight * loss, names

    def regularization(self, now: Moment, params: Gaussians) -> Regularization:
        """Return what the regularizers contribute to an update of `params`."""
        factors: Tensor | None = None
        active: list[tuple[RunningPlugin, StepContext]] = []
        for running in self._regs:
            context = self._context(running, now) if running.called_in_updates else None
            if context is None:
                continue
            active.append((running, context))
            if now.turn > 0 or not running.has("substeps"):  # substeps begin the update
                running.acted = False
            mask = self._factors(running, context, len(params))
            if mask is not None:
                factors = mask if factors is None else factors * mask
        with_loss = [pair for pair in active if pair[0].has("loss")]
        with_gradient = [pair for pair in active if pair[0].has("gradient")]
        return Regularization(
            factors,
            functools.partial(self._penalty, with_loss) if with_loss else None,
            functools.partial(self._gradient, with_gradient) if with_gradient else None,
        )

    def evaluated(self, now: Moment, gaussians: Gaussians) -> Gaussians:
        """Return the Gaussians that are evaluated instead of the trained ones, on the CPU.

        Only regularizers that acted in the last step (that of `now`) change them.
        """
        for running in self._regs:
            active = running.chosen.active(now.step / self._conditions.options.steps)
            if running.has("evaluated") and running.started and active:
                context = step_context(self._conditions, now, running.rng_key, _discard)
                result = running.call("evaluated", context, gaussians, running.state)
                gaussians = hooks.evaluated(running.plugin, result, gaussians.shN.shape[1])
        return gaussians

    def edits(
        self,
        now: Moment,
        stats: StepStats,
        apply: Callable[[Edits], tuple[Gaussians, Tensor | None]],
    ) -> None:
        """Let the capacities change the set after a step, one after another.

        Args:
            apply: applies edits; returns the new Gaussians and their previous rows, None if rows
                did not change.
        """
        if stats.radii.device.type != CPU:  # plugins work on the CPU
            stats = stats.map(Tensor.cpu)
        for running in self._capacities:
            context = self._context(running, now)
            if context is None:
                continue
            result = running.call("update", context, running.state, stats)
            edits, running.state = hooks.edits(running.plugin, result, now.gaussians)
            if edits is None:
                continue
            if edits.changes_something:
                self._dose.add(f"{running.key}.edits")
            gaussians, rows = apply(edits)
            if len(self._capacities) == 1:
                continue
            now = replace(now, gaussians=gaussians)
            if rows is not None:
                now, stats = replace(now, version=now.version + 1), _moved(stats, rows)
                self._move_states(running, rows)

    def states(self) -> dict[str, PluginState]:
        """Return the plugins' states by their keys, for a checkpoint."""
        return {r.key: PluginState(r.started, r.state) for r in self._all()}

    def load(
        self, states: Mapping[str, PluginState], logged: Mapping[str, float] | None = None
    ) -> None:
        """Continue from the states of a checkpoint."""
        for running in self._all():
            running.started = states[running.key].started
            running.state = states[running.key].value
        self.logged.update(logged or {})

    def warn_of_no_effect(self) -> None:
        """Warn about methods with little or no effect."""
        for running in (self._augment, *self._regs):
            if not running.idle:
                self._warn_of_calls(running)
        for running in self._capacities:
            self._warn_of_capacity(running)

    def _warn_of_capacity(self, running: RunningPlugin) -> None:
        name, steps = hooks.plugin_name(running.plugin), self._conditions.options.steps
        if running.plugin.second_field:  # its edits of the second field are not counted
            if not any(r.plugin.second_field for r in self._regs):
                LOG.warning(
                    f"{name}: changes only the second field, and no regularizer compares the two"
                    " fields, so it had no effect; add one that does, such as reg=co_register"
                )
        elif self._dose[f"{running.key}.edits"][0] == 0 and not running.idle:
            LOG.warning(
                f"{name}: changed no Gaussian in {steps} steps, like capacity=fixed; its options"
                f" set when it acts, see --help {name}"
            )

    def _warn_of_calls(self, running: RunningPlugin) -> None:
        calls, acted = self._dose[f"{running.key}.asked"]
        refused = self._dose[f"log.augment.{REFUSED}coverage"][0]
        what, why = "epochs", f"; in {refused} the coverage was below augment.min_coverage"
        if running is not self._augment:
            what, why, acted = "training steps", "", self._dose[f"{running.key}.acted"][0]
        name, key, chosen = hooks.plugin_name(running.plugin), running.key, running.chosen
        span = f"between {key}.start={chosen.start:g} and {key}.stop={chosen.stop:g}"
        if calls == 0:
            LOG.warning(
                f"{name}: was never called, so it had no effect: none of its {what} begins {span}"
                f" of {self._conditions.options.steps} steps; train longer, or change {key}.start"
            )
        elif acted < HALF * calls:
            LOG.warning(f"{name}: acted in only {acted:.0f} of {calls} {what} {span}{why}")

    def _count_act(self, running: RunningPlugin, acted: bool) -> None:
        """Count that a plugin acts in this update, once for all its views."""
        if acted and not running.acted:
            running.acted = True
            self._dose.add(f"{running.key}.acted")

    def _all(self) -> tuple[RunningPlugin, ...]:
        return self._augment, *self._regs, *self._capacities

    def _context(self, running: RunningPlugin, now: Moment) -> StepContext | None:
        """Return the plugin's context and initialise its state; None while it is not active."""
        if not running.chosen.active(now.step / self._conditions.options.steps):
            return None
        log = functools.partial(self._log, running)
        context = step_context(self._conditions, now, running.rng_key, log)
        if not running.started:
            running.started = True
            running.state = running.call("init_state", context)
        return context

    def _factors(self, running: RunningPlugin, context: StepContext, n: int) -> Tensor | None:
        """Return one regularizer's opacity factors, [N] or None."""
        if not running.idle:
            self._dose.add(f"{running.key}.asked")
        if not running.has("opacity_factors"):
            return None
        result = running.call("opacity_factors", context, running.state)
        factors, running.state = hooks.opacity_factors(running.plugin, result, n)
        if factors is not None:
            values = factors.detach().numpy()  # NumPy counts faster than torch
            if running.plugin.drops:
                self._dose.add(f"{running.key}.dropped", np.count_nonzero(values < 1) / n)
            self._count_act(running, bool((values != 1).any()))
        return factors

    def _penalty(
        self, active: Sequence[tuple[RunningPlugin, StepContext]], params: Gaussians
    ) -> Penalty:
        """Return the weighted sum of the loss terms as a function of a view and its render."""
        parameters = on_cpu(params)
        contexts = [(running, replace(ctx, gaussians=parameters)) for running, ctx in active]

        def penalty(view: View, render: Render) -> Tensor | float:
            total: Tensor | float = 0.0
            on_host = render.to(CPU)
            for running, context in contexts:
                term = running.call("loss", context, running.state, view, on_host)
                term = hooks.loss_term(running.plugin, term)
                self._count_act(running, term is not None)
                if term is not None:
                    total = total + running.chosen.weight * term
            return total.to(render.rgb.device) if isinstance(total, Tensor) else total

        return penalty

    def _gradient(
        self,
        active: Sequence[tuple[RunningPlugin, StepContext]],
        gradient: Gradients,
        at: GradientAt,
    ) -> Gradients:
        """Return the optimizer's gradient after each regularizer changed it in turn.

        A regularizer gets the gradient as those before it left it, also at other values.
        """
        device = gradient["means"].device

        def after(count: int, gaussians: Gaussians | None, gradient: Gradients) -> Gradients:
            """`gradient` as the first `count` regularizers leave it, at other Gaussians or, for
            None, at the step's own, where acts are counted."""
            for index, (running, context) in enumerate(active[:count]):
                if gaussians is not None:
                    context = replace(context, gaussians=gaussians, log=_discard)
                there = functools.partial(elsewhere, index)
                result = running.call("gradient", context, running.state, gradient, there)
                if gaussians is None:
                    self._count_act(running, result is not None)
                if result is not None:
                    gradient = hooks.gradient(running.plugin, result, gradient)
            return gradient

        def elsewhere(count: int, gaussians: Gaussians) -> Gradients:
            return after(count, gaussians, _moved_to(CPU, at(gaussians.to(device))))

        return _moved_to(device, after(len(active), None, _moved_to(CPU, gradient)))

    def _move_states(self, editor: RunningPlugin, rows: Tensor) -> None:
        """Let the other capacities follow a change of the rows."""
        for running in self._capacities:
            if running is not editor and running.started:
                with plugin_call(f"{hooks.plugin_name(running.plugin)}: followed"):
                    running.state = running.plugin.followed(running.state, rows)

    def _log(self, running: RunningPlugin, name: str, value: float) -> None:
        """Log a value: the last one goes into the history, the mean into the dose, there without
        the plugin's name."""
        if not isinstance(name, str) or not name.isprintable():
            raise UserError(f"ctx.log: expected a name in one line, got {name!r:.40}")
        if not isinstance(value, int | float | np.number):  # a tensor of one value
            value = float(value)
        self.logged[name] = value
        label = hooks.plugin_name(running.plugin).partition("=")[2]
        short = name.removeprefix(f"{label}_")
        if running is self._augment and short.startswith(REFUSED):
            self._refused = short  # an epoch counts once, after all its attempts
            return
        self._dose.add(f"log.{running.key}.{short}", value)


def _running(plugins: Plugins, group: str) -> tuple[RunningPlugin, ...]:
    """The plugins of a group at their start."""
    chosen = plugins.group(group).items()
    return tuple(
        RunningPlugin(key, key if i else group, one) for i, (key, one) in enumerate(chosen)
    )


def _discard(name: str, value: float) -> None:
    """The log of a second call in a step, and of an evaluation."""


def _moved(stats: StepStats, rows: Tensor) -> StepStats:
    """The measures of a step on an edited set; zeros, and a factor of 1, for new Gaussians.

    Args:
        rows: [N'] int64, for each Gaussian its previous row, -1 for a new one.
    """
    previous, kept = rows.clamp(min=0), rows >= 0

    def follow(values: Tensor) -> Tensor:
        return values[previous] * kept.view(-1, *[1] * (values.dim() - 1))

    moved = stats.map(follow)
    if moved.factors is None:
        return moved
    return replace(moved, factors=torch.where(kept, moved.factors, 1.0))


def _moved_to(device: str | torch.device, tensors: Gradients) -> Gradients:
    return {name: tensor.to(device) for name, tensor in tensors.items()}
