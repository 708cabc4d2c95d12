"""The shared trainer: every method of a study runs this loop with the same options.

A training step: pick the epoch's next view -> the regularizer scales opacities -> rasterize ->
photometric loss (+ regularizer term) -> gradient -> Adam -> the capacity plugin edits the set. At
each epoch's start the augmenter may add pseudo views; each joins the step of a real one and adds
its weighted loss. So every method takes the same steps on the same real views. The trainer holds a
`TrainingSet`, so no test view can be reached from here; `evaluate` is a callback that sees only the
Gaussians.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from torch import Tensor

from framework.compute.rng import stream
from framework.compute.stopwatch import Stopwatch
from framework.errors import require
from framework.fisher.information import FisherInformation, fisher_information
from framework.initialize import background_color, random_background
from framework.options import TrainerOptions
from framework.plugin import StepContext, StepStats
from framework.rasterize import rasterize
from framework.records.progress import Progress
from framework.records.run_files import HistoryRow
from framework.registry import Plugged
from framework.train import hooks, schedule
from framework.train.edits import apply_edits
from framework.train.epoch import Item, Items, ordered
from framework.train.gradient import (
    Penalty,
    ViewGradient,
    screen_gradient,
    step_stats,
    view_gradient,
)
from framework.train.guard import diverged
from framework.train.optim import Adam
from framework.train.resume.training_state import (
    Keeper,
    Plugins,
    PluginState,
    Trained,
    TrainerState,
)
from framework.types import PSEUDO, Camera, DepthMap, Gaussians, Render, TrainingSet, View

LOG = logging.getLogger(__name__)
HISTORY_ROWS = 60  # about so many rows of history per run, beside the evaluations


@dataclass
class _Running:
    """A plugin with what it remembers; its state is made when it is first active."""

    group: str
    plugged: Plugged
    state: Any = None
    started: bool = False


Evaluate = Callable[[Gaussians, Tensor, int], float | None]


class Trainer:
    """One training. `run` may be called once.

    evaluate(gaussians, background [3], sh_degree) -> mean test PSNR in dB, or None; called at the
    evaluation steps with copies, and its time does not count. keeper: is offered the state after
    every step. start: a kept state of the same training, to go on from instead of `gaussians`.
    sh_from: the degree of SH that is active in the first step. tells: whether to warn of a method
    that did nothing.
    """

    def __init__(
        self,
        training: TrainingSet,
        depth: tuple[DepthMap, ...],
        gaussians: Gaussians,
        options: TrainerOptions,
        plugins: Plugins,
        seed: int,
        progress: Progress,
        evaluate: Evaluate | None = None,
        keeper: Keeper | None = None,
        start: TrainerState | None = None,
        sh_from: int = 0,
        tells: bool = True,
    ) -> None:
        require(
            len(gaussians) > 0,
            f"{training.scene}: expected Gaussians to start from, got none; choose another init,"
            " another depth or more views",
        )
        self.training, self.depth, self.options = training, depth, options
        self.seed, self.progress, self.evaluate, self.keeper = seed, progress, evaluate, keeper
        self.sh_from = sh_from
        self.tells = tells and start is None  # a resumed training has not seen all
        self.augment = _Running("augment", plugins.augment)
        self.reg = _Running("reg", plugins.reg)
        self.capacity = _Running("capacity", plugins.capacity)
        self.near, self.extent = options.near_plane * training.near, training.extent
        fixed = background_color(options.background, training)
        self.random_background = fixed is None
        self.background: Tensor = _mean_color(training) if fixed is None else fixed
        self.params = gaussians.clone().map(_parameter)
        self.optimizer = Adam(self.params)
        self.items = Items()
        self.pseudo: list[View] = []
        self.queue: list[tuple[View, ...]] = []
        self.step, self.epoch, self.version = 0, -1, 0
        self.logged: dict[str, float] = {}
        self.history: list[HistoryRow] = []
        self.psnr: float | None = None
        self.watch, self.resumed = Stopwatch(), 0
        self.asked, self.given = 0, 0  # epochs that asked for pseudo views, what they got
        self.edits = 0  # of the set, by the capacity plugin
        if start is not None:
            self._take_up(start)

    def run(self) -> Trained:
        """Train for `options.steps` steps. Raises Diverged when loss, gradients or parameters
        stop being finite."""
        evaluations = schedule.evaluation_steps(self.options)
        every = max(1, self.options.steps // HISTORY_ROWS)
        while self.step < self.options.steps:
            loss = self._train_step(self._next_items())
            self.step += 1
            if self.step in evaluations or self.step % every == 0:
                with self.watch.paused() as seconds:
                    self._record(loss, seconds, self.step in evaluations)
            n = len(self.params)
            self.progress.step(self.step, self.options.steps, loss, n, self.psnr)
            if self.keeper is not None and self.keeper.due():
                self.keeper.keep(self.state())
        self._tell_what_did_nothing()
        return Trained(
            self.params.detach(),
            self.background,
            self._sh_degree(),
            tuple(self.history),
            self.watch.wall_s,
            self.watch.cpu_s,
            self.resumed,
        )

    def state(self) -> TrainerState:
        """All that is needed to go on from here, with tensors that the next step changes."""
        return TrainerState(
            step=self.step,
            epoch=self.epoch,
            version=self.version,
            left=len(self.queue),
            gaussians=self.params.detach(),
            adam=self.optimizer.state(),
            pseudo=tuple(self.pseudo),
            plugins={r.group: PluginState(r.started, r.state) for r in self._running()},
            history=tuple(self.history),
            logged=dict(self.logged),
            psnr=self.psnr,
            wall_s=self.watch.wall_s,
            cpu_s=self.watch.cpu_s,
            resumed=self.resumed,
        )

    def _tell_what_did_nothing(self) -> None:
        """A method without any effect is its baseline."""
        if not self.tells:
            return
        stored = self.params.sh_degree
        active = schedule.sh_degree(self.options, self.options.steps - 1, stored, self.sh_from)
        if active < stored:
            LOG.warning(
                f"trainer.sh_degree={stored}: only degree {active} was ever active, as"
                f" {self.options.steps} steps are few for trainer.sh_every={self.options.sh_every};"
                " the other bands are stored and 0; raise trainer.steps or set trainer.sh_every=0,"
                " which is over half of them"
            )
        augment, capacity = self.augment.plugged.plugin, self.capacity.plugged.plugin
        if self.asked > 0 and self.given == 0 and not augment.idle:
            LOG.warning(
                f"augment={augment.name}: no pseudo view in any of {self.asked}"
                " epochs that asked for one, so the method changed nothing; history.csv has what it"
                " logged, for instance the coverage that augment.min_coverage refuses"
            )
        if self.edits == 0 and not capacity.idle:
            LOG.warning(
                f"capacity={capacity.name}: no Gaussian was added or removed in"
                f" {self.options.steps} steps, as with capacity=fixed; when it may is set by its"
                " options, see python run.py --help capacity=" + capacity.name
            )

    def _take_up(self, state: TrainerState) -> None:
        self.step, self.epoch, self.version = state.step, state.epoch, state.version
        self.params = state.gaussians.map(_parameter)
        self.optimizer.load(state.adam)
        self.pseudo = list(state.pseudo)
        self.queue = self._ordered()[: state.left] if state.left else []
        for running in self._running():
            kept = state.plugins[running.group]
            running.started, running.state = kept.started, kept.value
        self.history, self.logged = list(state.history), dict(state.logged)
        self.psnr, self.resumed = state.psnr, state.resumed + 1
        self.watch = Stopwatch(state.wall_s, state.cpu_s)

    def _running(self) -> tuple[_Running, ...]:
        return self.augment, self.reg, self.capacity

    def _next_items(self) -> tuple[Item, ...]:
        """The epoch's next real view and the pseudo views that join it, at the current resolution;
        starts an epoch when needed."""
        if not self.queue:
            self.epoch += 1
            self.pseudo = self._pseudo_views()
            self.queue = self._ordered()
        return tuple(
            self.items.get(view, schedule.downsampling(self.options, self.step, view))
            for view in self.queue.pop()
        )

    def _ordered(self) -> list[tuple[View, ...]]:
        """The epoch's steps in their order; the last one is taken first."""
        return ordered(self.training.views, self.pseudo, self.seed, self.epoch)

    def _pseudo_views(self) -> list[View]:
        context = self._context_if_active(self.augment)
        if context is None:
            return []
        plugged = self.augment.plugged
        result = plugged.plugin.pseudo_views(context, self.augment.state)
        views, self.augment.state = hooks.pseudo_views(plugged.plugin, result)
        self.asked, self.given = self.asked + 1, self.given + len(views)
        return [
            replace(view, weight=view.weight * plugged.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def _train_step(self, items: tuple[Item, ...]) -> float:
        """One optimizer step on a real view, the first item, and the pseudo views that join it;
        returns the loss on the real one."""
        reg, first = self._context_if_active(self.reg), items[0]
        penalty, rendered = self._penalty_of(reg), self._rendered(reg)
        rates = schedule.learning_rates(self.options, self.step, self.extent)
        decay, ssim_weight = self.options.opacity_decay, self.options.ssim_weight
        if len(items) == 1 and penalty is None:
            loss, found = screen_gradient(
                self.params, first, self._where(first), ssim_weight, **rendered
            )
            broken, means2d = self.optimizer.step_from(found, rates, decay)
            stats = step_stats(first, means2d, found.radii)
        else:
            loss, gradients, stats = self._gradients(first, penalty, rendered)
            for item in items[1:]:
                for name, gradient in self._gradients(item, penalty, rendered)[1].items():
                    gradients[name].add_(gradient)
            broken = self.optimizer.step(self.params, gradients, rates, decay)
        if broken:
            state = self.optimizer.state()
            raise diverged(broken, self._where(first), self.params.detach(), state)
        self._edit(stats)
        return loss

    def _gradients(
        self, item: Item, penalty: Penalty | None, rendered: dict[str, Any]
    ) -> ViewGradient:
        where, ssim_weight = self._where(item), self.options.ssim_weight
        return view_gradient(self.params, item, where, ssim_weight, penalty, **rendered)

    def _penalty_of(self, reg: StepContext | None) -> Penalty | None:
        if reg is None or not self.reg.plugged.plugin.weighted():
            return None
        return functools.partial(self._penalty, reg)

    def _rendered(self, reg: StepContext | None) -> dict[str, Any]:
        """How the step renders its views."""
        return {
            "background": self._step_background(),
            "sh_degree": self._sh_degree(),
            "opacity_factors": self._opacity_factors(reg),
            "near": self.near,
        }

    def _where(self, item: Item) -> str:
        return f"training step {self.step} on view '{item.view.name}'"

    def _step_background(self) -> Tensor:
        if self.random_background:
            return random_background(self.seed, self.step)
        return self.background

    def _opacity_factors(self, context: StepContext | None) -> Tensor | None:
        if context is None:
            return None
        plugin: Any = self.reg.plugged.plugin
        result = plugin.opacity_factors(context, self.reg.state)
        factors, self.reg.state = hooks.opacity_factors(plugin, result, len(self.params))
        return factors

    def _penalty(self, context: StepContext, view: View, render: Render) -> Tensor | float:
        """The regularizer's weighted loss term; 0 without one."""
        plugged, context = self.reg.plugged, replace(context, gaussians=self.params)
        result = plugged.plugin.loss(context, self.reg.state, view, render)
        term = hooks.loss_term(plugged.plugin, result)
        return 0.0 if term is None else plugged.weight * term

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugin change the set, parameters and moments together."""
        context = self._context_if_active(self.capacity)
        if context is not None:
            plugin: Any = self.capacity.plugged.plugin
            result = plugin.update(context, self.capacity.state, stats)
            edits, self.capacity.state = hooks.edits(plugin, result, len(self.params))
            if edits is not None:
                self.edits += 1
                where = f"training step {self.step}"
                edited = apply_edits(self.params.detach(), self.optimizer, edits, where)
                self.params = edited.map(_parameter)
                self.version += int(edits.changes_the_rows)

    def _sh_degree(self) -> int:
        return schedule.sh_degree(self.options, self.step, self.params.sh_degree, self.sh_from)

    def _context_if_active(self, running: _Running) -> StepContext | None:
        """What the plugin may see now; None while it is not active."""
        if not running.plugged.active(self.step / self.options.steps):
            return None
        context = self._context(running.group)
        if not running.started:
            running.started = True
            running.state = running.plugged.plugin.init_state(context)
        return context

    def _context(self, group: str) -> StepContext:
        gaussians, active = self.params.detach(), self._sh_degree()
        fixed: dict[str, Any] = {"background": self.background, "near": self.near}

        def render(camera: Camera) -> Render:
            return rasterize(gaussians, camera, sh_degree=active, **fixed)

        def fisher(
            camera: Camera, others: Gaussians | None = None, sh_degree: int | None = None
        ) -> FisherInformation:
            chosen = gaussians if others is None else others
            degree = active if sh_degree is None else sh_degree
            return fisher_information(chosen, camera, sh_degree=degree, **fixed)

        def rng(purpose: str) -> np.random.Generator:
            return stream(self.seed, f"{group}/{purpose}", self.step)

        return StepContext(
            step=self.step,
            n_steps=self.options.steps,
            epoch=self.epoch,
            views=self.training.views,
            depth=self.depth,
            gaussians=gaussians,
            version=self.version,
            sh_degree=active,
            background=self.background,
            extent=self.extent,
            near=self.training.near,
            far=self.training.far,
            render=render,
            fisher=fisher,
            rng=rng,
            log=self.logged.__setitem__,
        )

    def _record(self, loss: float, seconds: float, evaluating: bool) -> None:
        """A row of the history; on evaluation steps with the test PSNR."""
        psnr: float | None = None
        if evaluating and self.evaluate is not None:
            psnr = self.evaluate(self.params.clone(), self.background, self._sh_degree())
            self.psnr = psnr
        self.history.append(
            HistoryRow(
                step=self.step,
                seconds=seconds,
                loss=loss,
                gaussians=len(self.params),
                sh_degree=self._sh_degree(),
                test_psnr=psnr,
                logged=dict(self.logged),
            )
        )
        self.logged.clear()


def _parameter(tensor: Tensor) -> Tensor:
    """A leaf that the optimizer may change in place."""
    return tensor.detach().contiguous().requires_grad_()


def _mean_color(training: TrainingSet) -> Tensor:
    colour = background_color("mean", training)
    assert colour is not None, "only a random background has no colour"
    return colour
