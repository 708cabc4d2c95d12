"""The shared trainer: every method of a study runs this loop with the same options.

A training step: pick the epoch's next view -> the regularizer scales opacities -> rasterize ->
photometric loss (+ regularizer term) -> gradient -> Adam -> the capacity plugin edits the set. At
each epoch's start the augmenter may add pseudo views; each joins the step of a real one and adds
its weighted loss, or has an update of its own before it (`trainer.pseudo_steps`). A step is one
real view's in both cases and what pseudo views do comes on top: so every method takes the same
steps on the same real views, and rates, SH bands, capacity, evaluations and checkpoints, which go
by the step, mean the same for all. The paper counts both: its T updates with one pseudo view per
epoch of K photos are T K / (K + 1) steps here. The trainer holds a `TrainingSet`, so no test view
can be reached from here; `evaluate` is a callback that sees only the Gaussians.
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
from framework.rasterizers import NUMBA, Rasterizer
from framework.records.progress import Progress
from framework.records.run_files import HistoryRow
from framework.train import schedule
from framework.train.context import Conditions, Moment
from framework.train.descent import descend
from framework.train.dose import Dose
from framework.train.edits import apply_edits
from framework.train.epoch import Item, Items, ordered
from framework.train.plugged import PluginsAtWork
from framework.train.resume.training_state import Keeper, Plugins, Trained, TrainerState
from framework.train.torch_adam import optimizer_of
from framework.types import PSEUDO, DepthMap, Gaussians, TrainingSet, View

LOG = logging.getLogger(__name__)
HISTORY_ROWS = 60  # about so many rows of history per run, beside the evaluations

Evaluate = Callable[[Gaussians, Tensor, int], float | None]


class Trainer:
    """One training. `run` may be called once.

    evaluate(gaussians, background [3], sh_degree) -> mean test PSNR in dB, or None; called at the
    evaluation steps with copies, and its time does not count. keeper: is offered the state after
    every step. start: a kept state of the same training, to go on from instead of `gaussians`.
    sh_from: the degree of SH that is active in the first step. tells: whether to warn of a method
    that did nothing. rasterizer: who draws; parameters, moments and targets are on its device, what
    is given and what comes out on the CPU.
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
        rasterizer: Rasterizer = NUMBA,
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
        self.tells, self.rasterizer = tells, rasterizer
        self.near, self.extent = options.near_plane * training.near, training.extent
        fixed = background_color(options.background, training)
        self.random_background = fixed is None
        self.background: Tensor = _mean_color(training) if fixed is None else fixed
        conditions = Conditions(
            training, depth, options, self.background, self.near, seed, rasterizer
        )
        self.dose = Dose()
        self.plugins = PluginsAtWork(plugins, conditions, self.dose)
        self.params = self._placed(gaussians.clone())
        self.optimizer = optimizer_of(rasterizer, self.params)
        self.items = Items(options.pseudo_mean == "covered", rasterizer)
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
            self.params.detach().to("cpu"),
            self.background,
            self._sh_degree(),
            tuple(self.history),
            self.watch.wall_s,
            self.watch.cpu_s,
            self.resumed,
            self.dose.kept(),
        )

    def _train_step(self) -> float:
        """Pick, render, lose, step, edit. Returns the loss on the real view.

        A pseudo view's own update comes before its real one: so every step, and the training, ends
        on a photo, and what the capacity plugin sees of it is of the Gaussians as they are.
        """
        real, *pseudo = self._pick()
        if self.options.pseudo_steps == "own":
            for turn, item in enumerate(pseudo, 1):
                self._update([item], turn)
            pseudo = []
        loss, stats = self._update([real, *pseudo])
        self._edit(stats)
        return loss

    def _update(self, items: list[Item], turn: int = 0) -> tuple[float, StepStats]:
        """One descent down the losses on `items`; the loss on the first, and what was seen of it.

        Opacities fade in those on real views alone: so much per step, whatever joins it.
        """
        factors, penalty = self.plugins.regularization(self._now(turn), self.params)
        losses, stats = descend(
            self.params,
            self.optimizer,
            items,
            self.step,
            schedule.learning_rates(self.options, self.step, self.extent),
            self.options.opacity_decay if turn == 0 else 1.0,
            self.options.ssim_weight,
            penalty,
            self.rasterizer,
            **self._rendered(factors),
        )
        self.dose.add("steps")
        for item, loss in zip(items, losses, strict=True):
            self.dose.add("loss.pseudo" if PSEUDO in item.view.tags else "loss.real", loss)
        return losses[0], stats

    def _pick(self) -> tuple[Item, ...]:
        """The epoch's next real view and the pseudo views of its step, at the current resolution;
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

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugin change the set, parameters and moments together."""
        edits = self.plugins.edits(self._now(), stats)
        if edits is not None:
            where = f"training step {self.step}"
            edited = apply_edits(self.params.detach(), self.optimizer, edits, where)
            self.params = self._placed(edited)
            self.version += int(edits.changes_the_rows)

    def _placed(self, gaussians: Gaussians) -> Gaussians:
        """`gaussians` as parameters on the rasterizer's device."""
        return gaussians.to(self.rasterizer.device).map(_parameter)

    def _sh_degree(self) -> int:
        return schedule.sh_degree(self.options, self.step, self.params.sh_degree, self.sh_from)

    def _now(self, turn: int = 0) -> Moment:
        """Where the training stands, as plugins see it."""
        gaussians, degree = self.params.detach(), self._sh_degree()
        return Moment(self.step, self.epoch, self.version, gaussians, degree, turn)

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
            gaussians=self.params.detach().to("cpu"),
            adam=self.optimizer.state(),
            pseudo=tuple(self.pseudo),
            plugins=self.plugins.kept(),
            history=tuple(self.history),
            logged=dict(self.plugins.logged),
            dose=self.dose.kept(),
            psnr=self.psnr,
            wall_s=self.watch.wall_s,
            cpu_s=self.watch.cpu_s,
            resumed=self.resumed,
        )

    def _take_up(self, state: TrainerState) -> None:
        self.step, self.epoch, self.version = state.step, state.epoch, state.version
        self.params = self._placed(state.gaussians)
        self.optimizer.load(state.adam)
        self.pseudo = list(state.pseudo)
        self.queue = self._ordered()[: state.left] if state.left else []
        self.plugins.take_up(state.plugins, state.logged)
        self.dose.take_up(state.dose)
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
