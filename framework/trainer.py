"""The shared trainer: every method of a study runs this loop with the same options.

A training step: pick the epoch's next view -> the regularizer scales opacities -> rasterize ->
photometric loss (+ regularizer term) -> gradient -> Adam -> the capacity plugin edits the set. At
each epoch's start the augmenter may add pseudo views. The trainer holds a `TrainingSet`, so no test
view can be reached from here; `evaluate` is a callback that sees only the Gaussians.

Rates and schedule: 3DGS (Kerbl et al. 2023) times `lr_scale`; the means' rate decays exponentially
over the whole training, the others' over its second half.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from framework.errors import UserError
from framework.fisher import FisherInformation, fisher_information
from framework.initialize import background_color, random_background
from framework.losses import Target, photometric_loss
from framework.optim import Adam, decay_opacities
from framework.options import TrainerOptions
from framework.plugin import Edits, StepContext, StepStats
from framework.progress import Progress
from framework.rasterize import rasterize
from framework.registry import Plugged
from framework.rng import stream
from framework.run_files import HistoryRow
from framework.types import (
    Camera,
    DepthMap,
    Gaussians,
    Render,
    TrainingSet,
    View,
    concatenate,
)

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


@dataclass(frozen=True)
class _Item:
    """A view of the epoch at the resolution that is trained now."""

    view: View
    camera: Camera
    target: Target


@dataclass
class _States:
    """What the plugins remember."""

    augment: Any = None
    reg: Any = None
    capacity: Any = None
    started: set[str] = field(default_factory=set)


Evaluate = Callable[[Gaussians, Tensor, int], float]


class Trainer:
    """One training. `run` may be called once."""

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
        self.plugins, self.seed, self.progress = plugins, seed, progress
        self.evaluate = evaluate
        self.near = options.near_plane * training.near
        fixed = background_color(options.background, training, seed)
        self.random_background = fixed is None
        self.background: Tensor = _mean_color(training) if fixed is None else fixed
        self.params = gaussians.map(lambda t: t.detach().clone().requires_grad_())
        self.optimizer = Adam(self.params)
        self.states = _States()
        self.version = 0
        self.step = 0
        self.epoch = -1
        self.queue: list[View] = []
        self.real_items: dict[tuple[str, int], _Item] = {}
        self.logged: dict[str, float] = {}
        self.history: list[HistoryRow] = []
        self.psnr: float | None = None

    def run(self) -> Trained:
        """Train for `options.steps` steps. Raises UserError when the loss stops being finite."""
        started, excluded = time.perf_counter(), 0.0
        while self.step < self.options.steps:
            item = self._next_item()
            loss = self._train_step(item)
            self.step += 1
            self._check_finite(loss, item)
            evaluating = self.step in self._evaluation_steps()
            if evaluating or self.step % max(1, self.options.steps // HISTORY_ROWS) == 0:
                seconds = time.perf_counter() - started - excluded
                before = time.perf_counter()
                self._record(loss, seconds, evaluating)
                excluded += time.perf_counter() - before
            n = len(self.params)
            self.progress.step(self.step, self.options.steps, loss, n, self.psnr)
        train_s = time.perf_counter() - started - excluded
        gaussians = self.params.clone()
        return Trained(gaussians, self.background, self._sh_degree(), tuple(self.history), train_s)

    def _next_item(self) -> _Item:
        """The next view of the epoch, at the current resolution; starts an epoch when needed."""
        if not self.queue:
            self.epoch += 1
            views = [*self.training.views, *self._pseudo_views()]
            order = stream(self.seed, "epoch", self.epoch).permutation(len(views))
            self.queue = [views[i] for i in order]
        view = self.queue.pop()
        factor = self._downsampling(view)
        if "pseudo" in view.tags:
            return _item(view, factor)
        key = (view.name, factor)
        if key not in self.real_items:
            self.real_items[key] = _item(view, factor)
        return self.real_items[key]

    def _pseudo_views(self) -> list[View]:
        plugged = self.plugins.augment
        if not plugged.active(self.step / self.options.steps):
            return []
        context = self._context("augment")
        if "augment" not in self.states.started:
            self.states.started.add("augment")
            self.states.augment = plugged.plugin.init_state(context)
        views, self.states.augment = plugged.plugin.pseudo_views(context, self.states.augment)
        return [_weighted(view, plugged.weight) for view in views]

    def _train_step(self, item: _Item) -> float:
        """One optimizer step on one view; returns the loss."""
        offset = torch.zeros(len(self.params), 2, requires_grad=True)
        background = (
            random_background(self.seed, self.step) if self.random_background else self.background
        )
        render = rasterize(
            self.params,
            item.camera,
            background=background,
            sh_degree=self._sh_degree(),
            opacity_factors=self._opacity_factors(),
            means2d_offset=offset,
            near=self.near,
        )
        loss = photometric_loss(render.rgb, item.target, self.options.ssim_weight)
        loss = loss * item.view.weight
        loss = self._regularized(loss, item.view, render)
        inputs = [tensor for _, tensor in self.params.items()]
        *gradients, pull = torch.autograd.grad(loss, [*inputs, offset])
        names = [name for name, _ in self.params.items()]
        grads = dict(zip(names, gradients, strict=True))
        self.optimizer.step(self.params, grads, self._rates())
        decay_opacities(self.params.opacity_logits, self.options.opacity_decay)
        self._edit(StepStats(pull, render.radii, item.camera.width, item.camera.height))
        return float(loss.detach())

    def _opacity_factors(self) -> Tensor | None:
        if not self._regularizing():
            return None
        context = self._context("reg")
        if "reg" not in self.states.started:
            self.states.started.add("reg")
            self.states.reg = self.plugins.reg.plugin.init_state(context)
        factors, self.states.reg = self.plugins.reg.plugin.opacity_factors(context, self.states.reg)
        return factors  # type: ignore[no-any-return]

    def _regularized(self, loss: Tensor, view: View, render: Render) -> Tensor:
        if not self._regularizing():
            return loss
        plugged = self.plugins.reg
        term = plugged.plugin.loss(self._context("reg"), self.states.reg, view, render)
        return loss if term is None else loss + plugged.weight * term

    def _regularizing(self) -> bool:
        return self.plugins.reg.active(self.step / self.options.steps)

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugin change the set, parameters and moments together."""
        plugged = self.plugins.capacity
        if not plugged.active(self.step / self.options.steps):
            return
        context = self._context("capacity")
        if "capacity" not in self.states.started:
            self.states.started.add("capacity")
            self.states.capacity = plugged.plugin.init_state(context)
        edits, self.states.capacity = plugged.plugin.update(context, self.states.capacity, stats)
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

    def _rates(self) -> dict[str, float]:
        """Learning rate of every tensor at this step."""
        o = self.options
        progress = self.step / o.steps
        others = o.lr_scale * o.lr_final ** max(0.0, 2 * progress - 1)
        means = o.lr_scale * o.lr_means * self.training.extent * o.lr_means_final**progress
        return {
            "means": means,
            "quats": o.lr_quats * others,
            "log_scales": o.lr_scales * others,
            "opacity_logits": o.lr_opacities * others,
            "sh0": o.lr_sh0 * others,
            "shN": o.lr_sh0 * o.lr_shN_ratio * others,
        }

    def _sh_degree(self) -> int:
        """The active SH degree: one more every `sh_every` steps, up to the stored one."""
        return min(self.params.sh_degree, self.step // self.options.sh_every)

    def _downsampling(self, view: View) -> int:
        coarse = self.step < self.options.coarse_until * self.options.steps
        factor = self.options.coarse_factor if coarse else 1
        while min(view.camera.width, view.camera.height) // factor < 16 and factor > 1:
            factor //= 2  # a tiny image has nothing to gain from a coarse phase
        return factor

    def _context(self, group: str) -> StepContext:
        """What a plugin of `group` may see now."""
        gaussians = self.params.detach()
        degree = self._sh_degree()

        def render(camera: Camera) -> Render:
            return rasterize(
                gaussians, camera, background=self.background, sh_degree=degree, near=self.near
            )

        def fisher(
            camera: Camera, others: Gaussians | None = None, sh_degree: int | None = None
        ) -> FisherInformation:
            return fisher_information(
                gaussians if others is None else others,
                camera,
                background=self.background,
                sh_degree=degree if sh_degree is None else sh_degree,
                near=self.near,
            )

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
            sh_degree=degree,
            background=self.background,
            extent=self.training.extent,
            near=self.training.near,
            far=self.training.far,
            render=render,
            fisher=fisher,
            rng=rng,
            log=self.logged.__setitem__,
        )

    def _evaluation_steps(self) -> set[int]:
        n, steps = self.options.evaluations, self.options.steps
        return {steps * (i + 1) // n for i in range(n)}

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

    def _check_finite(self, loss: float, item: _Item) -> None:
        if not math.isfinite(loss):
            raise UserError(
                f"training step {self.step} on view '{item.view.name}': expected a finite loss, got"
                f" {loss}; lower trainer.lr_scale (now {self.options.lr_scale:g})"
            )


def _mean_color(training: TrainingSet) -> Tensor:
    colour = background_color("mean", training)
    assert colour is not None, "only a random background has no colour"
    return colour


def _weighted(view: View, weight: float) -> View:
    return View(
        view.name, view.camera, view.image, view.mask, view.weight * weight, view.depth, view.tags
    )


def _item(view: View, factor: int) -> _Item:
    """`view` box-downsampled by `factor`; a pixel is valid if all it covers is."""
    camera = view.camera.scaled(factor)
    if factor == 1:
        return _Item(view, camera, Target.of(view.image, view.mask))
    mask = None
    if view.mask is not None:
        mask = (_box(view.mask[None], factor)[0] > 0.999).float()
    image = _box(view.image, factor)
    coarse = replace(view, camera=camera, image=image, mask=mask, depth=None)
    return _Item(coarse, camera, Target.of(image, mask))


def _box(image: Tensor, factor: int) -> Tensor:
    """Mean over factor x factor boxes of [C, H, W]; a last, incomplete row or column is cut."""
    channels, height, width = image.shape
    h, w = height // factor, width // factor
    boxes = image[:, : h * factor, : w * factor].numpy().reshape(channels, h, factor, w, factor)
    return torch.from_numpy(boxes.mean(axis=(2, 4), dtype=np.float64).astype(np.float32))
