"""The shared trainer: every method of a study runs this loop with the same options.

A training step: pick the epoch's next view -> the regularizer scales opacities -> rasterize ->
photometric loss (+ regularizer term) -> gradient -> Adam -> the capacity plugin edits the set. At
each epoch's start the augmenter may add pseudo views. The trainer holds a `TrainingSet`, so no test
view can be reached from here; `evaluate` is a callback that sees only the Gaussians.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework import schedule
from framework.epoch import PSEUDO, Item, Items
from framework.errors import UserError
from framework.fisher import FisherInformation, fisher_information
from framework.initialize import background_color, random_background
from framework.losses import photometric_loss
from framework.optim import Adam, decay_opacities
from framework.options import TrainerOptions
from framework.plugin import Edits, StepContext, StepStats
from framework.progress import Progress
from framework.rasterize import rasterize
from framework.registry import Plugged
from framework.rng import stream
from framework.run_files import HistoryRow
from framework.types import Camera, DepthMap, Gaussians, Render, TrainingSet, View, concatenate

HISTORY_ROWS = 60  # about so many rows of history per run, beside the evaluations


@dataclass(frozen=True)
class Plugins:
    """The three chosen plugins with their framework keys."""

    augment: Plugged
    reg: Plugged
    capacity: Plugged


@dataclass(frozen=True)
class Trained:
    """What a training gives. background: [3], what renders for evaluation stand on."""

    gaussians: Gaussians
    background: Tensor
    sh_degree: int
    history: tuple[HistoryRow, ...]
    train_s: float


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
    evaluation steps with copies, and its time does not count.
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
    ) -> None:
        self.training, self.depth, self.options = training, depth, options
        self.seed, self.progress, self.evaluate = seed, progress, evaluate
        self.augment = _Running("augment", plugins.augment)
        self.reg = _Running("reg", plugins.reg)
        self.capacity = _Running("capacity", plugins.capacity)
        self.near, self.extent = options.near_plane * training.near, training.extent
        fixed = background_color(options.background, training, seed)
        self.random_background = fixed is None
        self.background: Tensor = _mean_color(training) if fixed is None else fixed
        self.params = gaussians.map(lambda t: t.detach().clone().requires_grad_())
        self.optimizer = Adam(self.params)
        self.items = Items()
        self.queue: list[View] = []
        self.step, self.epoch, self.version = 0, -1, 0
        self.logged: dict[str, float] = {}
        self.history: list[HistoryRow] = []
        self.psnr: float | None = None

    def run(self) -> Trained:
        """Train for `options.steps` steps. Raises UserError when the loss stops being finite."""
        started, excluded = time.perf_counter(), 0.0
        evaluations = schedule.evaluation_steps(self.options)
        every = max(1, self.options.steps // HISTORY_ROWS)
        while self.step < self.options.steps:
            loss = self._train_step(self._next_item())
            self.step += 1
            if self.step in evaluations or self.step % every == 0:
                before = time.perf_counter()
                self._record(loss, before - started - excluded, self.step in evaluations)
                excluded += time.perf_counter() - before
            n = len(self.params)
            self.progress.step(self.step, self.options.steps, loss, n, self.psnr)
        train_s = time.perf_counter() - started - excluded
        history = tuple(self.history)
        return Trained(self.params.clone(), self.background, self._sh_degree(), history, train_s)

    def _next_item(self) -> Item:
        """The next view of the epoch, at the current resolution; starts an epoch when needed."""
        if not self.queue:
            self.epoch += 1
            views = [*self.training.views, *self._pseudo_views()]
            order = stream(self.seed, "epoch", self.epoch).permutation(len(views))
            self.queue = [views[i] for i in order]
        view = self.queue.pop()
        return self.items.get(view, schedule.downsampling(self.options, self.step, view.camera))

    def _pseudo_views(self) -> list[View]:
        context = self._context_if_active(self.augment)
        if context is None:
            return []
        plugged = self.augment.plugged
        views, self.augment.state = plugged.plugin.pseudo_views(context, self.augment.state)
        return [
            replace(view, weight=view.weight * plugged.weight, tags=(*view.tags, PSEUDO))
            for view in views
        ]

    def _train_step(self, item: Item) -> float:
        """One optimizer step on one view; returns the loss."""
        view, pull = item.view, torch.zeros(len(self.params), 2, requires_grad=True)
        reg = self._context_if_active(self.reg)
        render = rasterize(
            self.params,
            view.camera,
            background=self._step_background(),
            sh_degree=self._sh_degree(),
            opacity_factors=self._opacity_factors(reg),
            means2d_offset=pull,
            near=self.near,
        )
        loss = photometric_loss(render.rgb, item.target, self.options.ssim_weight) * view.weight
        loss = loss + self._penalty(reg, view, render)
        value = self._finite(float(loss.detach()), view)
        tensors = dict(self.params.items())
        *gradients, d_pull = torch.autograd.grad(loss, [*tensors.values(), pull])
        rates = schedule.learning_rates(self.options, self.step, self.extent)
        self.optimizer.step(self.params, dict(zip(tensors, gradients, strict=True)), rates)
        decay_opacities(self.params.opacity_logits, self.options.opacity_decay)
        self._edit(StepStats(d_pull, render.radii, view.camera.width, view.camera.height))
        return value

    def _step_background(self) -> Tensor:
        if self.random_background:
            return random_background(self.seed, self.step)
        return self.background

    def _opacity_factors(self, context: StepContext | None) -> Tensor | None:
        if context is None:
            return None
        plugin: Any = self.reg.plugged.plugin
        factors: Tensor | None
        factors, self.reg.state = plugin.opacity_factors(context, self.reg.state)
        return factors

    def _penalty(self, context: StepContext | None, view: View, render: Render) -> Tensor | float:
        """The regularizer's weighted loss term; 0 without one."""
        if context is None:
            return 0.0
        plugged = self.reg.plugged
        term: Tensor | None = plugged.plugin.loss(context, self.reg.state, view, render)
        return 0.0 if term is None else plugged.weight * term

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugin change the set, parameters and moments together."""
        context = self._context_if_active(self.capacity)
        if context is not None:
            plugin: Any = self.capacity.plugged.plugin
            edits, self.capacity.state = plugin.update(context, self.capacity.state, stats)
            if edits is not None:
                self._apply(edits)

    def _apply(self, edits: Edits) -> None:
        params = self.params.detach()
        if edits.keep is not None or edits.append is not None:
            kept = params if edits.keep is None else params[edits.keep]
            params = kept if edits.append is None else concatenate([kept, edits.append])
            self.optimizer.edit(edits.keep, 0 if edits.append is None else len(edits.append))
            self.version += 1
        if edits.opacity_ceiling is not None:
            ceiling = math.log(edits.opacity_ceiling / (1 - edits.opacity_ceiling))
            params = params.replace(opacity_logits=params.opacity_logits.clamp(max=ceiling))
            self.optimizer.zero("opacity_logits")
        if len(params) == 0:
            raise UserError(
                f"training step {self.step}: the capacity plugin removed every Gaussian; raise"
                " init.budget or lower its pruning threshold"
            )
        self.params = params.map(lambda t: t.detach().contiguous().requires_grad_())

    def _sh_degree(self) -> int:
        return schedule.sh_degree(self.options, self.step, self.params.sh_degree)

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
        psnr = None
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

    def _finite(self, loss: float, view: View) -> float:
        if not math.isfinite(loss):
            raise UserError(
                f"training step {self.step} on view '{view.name}': expected a finite loss, got"
                f" {loss}; lower trainer.lr_scale (now {self.options.lr_scale:g})"
            )
        return loss


def _mean_color(training: TrainingSet) -> Tensor:
    colour = background_color("mean", training)
    assert colour is not None, "only a random background has no colour"
    return colour
