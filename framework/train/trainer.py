"""The shared trainer: every method of a study runs this loop with the same options.

A training step: pick the epoch's next view -> the regularizer scales opacities -> rasterize ->
photometric loss (+ regularizer term) -> gradient -> Adam -> the capacity plugin edits the set. At
each epoch's start the augmenter may add pseudo views; each joins the step of a real one and adds
its weighted loss. So every method takes the same steps on the same real views. The trainer holds a
`TrainingSet`, so no test view can be reached from here; `evaluate` is a callback that sees only the
Gaussians.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from torch import Tensor

from framework.compute.stopwatch import Stopwatch
from framework.errors import require
from framework.initialize import background_color, random_background
from framework.options import TrainerOptions
from framework.plugin import StepStats
from framework.records.progress import Progress
from framework.records.run_files import HistoryRow
from framework.train import schedule
from framework.train.context import Conditions, Moment
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
from framework.train.plugged import PluginsAtWork
from framework.train.resume.training_state import Keeper, Plugins, Trained, TrainerState
from framework.types import DepthMap, Gaussians, TrainingSet, View

LOG = logging.getLogger(__name__)
HISTORY_ROWS = 60  # about so many rows of history per run, beside the evaluations

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
        self.training, self.seed = training, seed
        self.options = options = schedule.paced(options, len(training.views))
        self.progress, self.evaluate, self.keeper = progress, evaluate, keeper
        self.sh_from = sh_from
        self.tells = tells and start is None  # a resumed training has not seen all
        self.near, self.extent = options.near_plane * training.near, training.extent
        fixed = background_color(options.background, training)
        self.random_background = fixed is None
        self.background: Tensor = _mean_color(training) if fixed is None else fixed
        conditions = Conditions(training, depth, options, self.background, self.near, seed)
        self.plugins = PluginsAtWork(plugins, conditions)
        self.params = gaussians.clone().map(_parameter)
        self.optimizer = Adam(self.params)
        self.items = Items()
        self.pseudo: list[View] = []
        self.queue: list[tuple[View, ...]] = []
        self.step, self.epoch, self.version = 0, -1, 0
        self.history: list[HistoryRow] = []
        self.psnr: float | None = None
        self.watch, self.resumed = Stopwatch(), 0
        if start is not None:
            self._take_up(start)

    def run(self) -> Trained:
        """Train for `options.steps` steps. Raises Diverged when loss, gradients or parameters
        stop being finite."""
        evaluations = schedule.evaluation_steps(self.options)
        every = max(1, self.options.steps // HISTORY_ROWS)
        while self.step < self.options.steps:
            loss = self._train_step()
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

    def _train_step(self) -> float:
        """Pick, render, lose, step, edit. Returns the loss on the real view."""
        items = self._pick()
        factors, penalty = self.plugins.regularization(self._now(), self.params)
        loss, stats = self._descend(items, penalty, self._rendered(factors))
        self._edit(stats)
        return loss

    def _pick(self) -> tuple[Item, ...]:
        """The epoch's next real view and the pseudo views that join it, at the current resolution;
        starts an epoch when needed."""
        if not self.queue:
            self.epoch += 1
            self.pseudo = self.plugins.pseudo_views(self._now())
            self.queue = self._ordered()
        return tuple(
            self.items.get(view, schedule.downsampling(self.options, self.step, view))
            for view in self.queue.pop()
        )

    def _ordered(self) -> list[tuple[View, ...]]:
        """The epoch's steps in their order; the last one is taken first."""
        return ordered(self.training.views, self.pseudo, self.seed, self.epoch)

    def _rendered(self, factors: Tensor | None) -> dict[str, Any]:
        """How the step renders its views. factors: [N] of the opacities."""
        background = (
            random_background(self.seed, self.step) if self.random_background else self.background
        )
        return {
            "background": background,
            "sh_degree": self._sh_degree(),
            "opacity_factors": factors,
            "near": self.near,
        }

    def _descend(
        self, items: tuple[Item, ...], penalty: Penalty | None, rendered: dict[str, Any]
    ) -> tuple[float, StepStats]:
        """Adam's step down the losses on a real view, the first item, and the pseudo views that
        join it; gives the loss and what was seen of the real one.

        A lone view's gradient goes from the screen into Adam while the cache has it; the others'
        are summed as a whole.
        """
        rates = schedule.learning_rates(self.options, self.step, self.extent)
        decay, ssim_weight = self.options.opacity_decay, self.options.ssim_weight
        first = items[0]
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
        return loss, stats

    def _gradients(
        self, item: Item, penalty: Penalty | None, rendered: dict[str, Any]
    ) -> ViewGradient:
        where, ssim_weight = self._where(item), self.options.ssim_weight
        return view_gradient(self.params, item, where, ssim_weight, penalty, **rendered)

    def _where(self, item: Item) -> str:
        return f"training step {self.step} on view '{item.view.name}'"

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugin change the set, parameters and moments together."""
        edits = self.plugins.edits(self._now(), stats)
        if edits is not None:
            where = f"training step {self.step}"
            edited = apply_edits(self.params.detach(), self.optimizer, edits, where)
            self.params = edited.map(_parameter)
            self.version += int(edits.changes_the_rows)

    def _sh_degree(self) -> int:
        return schedule.sh_degree(self.options, self.step, self.params.sh_degree, self.sh_from)

    def _now(self) -> Moment:
        """Where the training stands, as plugins see it."""
        gaussians, degree = self.params.detach(), self._sh_degree()
        return Moment(self.step, self.epoch, self.version, gaussians, degree)

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
                logged=dict(self.plugins.logged),
            )
        )
        self.plugins.logged.clear()

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
            plugins=self.plugins.kept(),
            history=tuple(self.history),
            logged=dict(self.plugins.logged),
            psnr=self.psnr,
            wall_s=self.watch.wall_s,
            cpu_s=self.watch.cpu_s,
            resumed=self.resumed,
        )

    def _take_up(self, state: TrainerState) -> None:
        self.step, self.epoch, self.version = state.step, state.epoch, state.version
        self.params = state.gaussians.map(_parameter)
        self.optimizer.load(state.adam)
        self.pseudo = list(state.pseudo)
        self.queue = self._ordered()[: state.left] if state.left else []
        self.plugins.take_up(state.plugins, state.logged)
        self.history = list(state.history)
        self.psnr, self.resumed = state.psnr, state.resumed + 1
        self.watch = Stopwatch(state.wall_s, state.cpu_s)

    def _tell_what_did_nothing(self) -> None:
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
        self.plugins.tell_what_did_nothing()


def _parameter(tensor: Tensor) -> Tensor:
    """A leaf that the optimizer may change in place."""
    return tensor.detach().contiguous().requires_grad_()


def _mean_color(training: TrainingSet) -> Tensor:
    colour = background_color("mean", training)
    assert colour is not None, "only a random background has no colour"
    return colour
