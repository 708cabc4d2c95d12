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
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer
from framework.compute.stopwatch import Stopwatch
from framework.errors import require
from framework.initialize import background_color, random_background
from framework.options import TrainerOptions
from framework.plugin import Edits, StepStats
from framework.records.progress import Progress
from framework.records.run_files import HistoryRow
from framework.train import schedule
from framework.train.binocular import Binocular
from framework.train.context import Conditions, Moment
from framework.train.descent import Fading, descend, substep
from framework.train.dose import Dose
from framework.train.epoch import Item, Items, ordered
from framework.train.field import Field
from framework.train.plugin_calls import PluginCalls
from framework.train.resume.training_state import Keeper, Plugins, Trained, TrainerState
from framework.train.smoothness import DepthSmoothness
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
    that did nothing. rasterizer: who draws; parameters, moments and targets are on its device, what
    is given and what comes out on the CPU. second: what a second field begins with; None: with what
    the first does.
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
        second: Gaussians | None = None,
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
        self.random_background = options.background == "random"
        self.background = background_color(options.background, training)
        self.conditions = conditions = Conditions(
            training, depth, options, self.background, self.near, seed, rasterizer
        )
        self.dose = Dose()
        self.field = Field.of(gaussians, PluginCalls(plugins, conditions, self.dose), rasterizer)
        require(
            rasterizer.single_pixels or not self.field.plugins.absolute,
            f"rasterizer={rasterizer.name}: expected one that tells the pull of single pixels, for"
            " the absolute gradients that a capacity asks for; use rasterizer=numba, or turn that"
            " option off, for instance capacity.absolute=false",
        )
        self.second: Field | None = None
        if plugins.second_field:
            conditions = replace(conditions, field="second/")
            if second is not None and torch.equal(second.means, gaussians.means):
                LOG.warning(
                    "second_drawn: this init draws nothing, so the second field begins with the"
                    " Gaussians of the first all the same"
                )
            self.second = Field.of(
                gaussians if second is None else second,
                PluginCalls(plugins, conditions, Dose()),
                rasterizer,
            )
        self.items = Items(options.pseudo_mean == "covered", rasterizer, self._smoothness())
        self.binocular = self._binocular()
        self.pseudo: list[View] = []
        self.queue: list[tuple[View, ...]] = []
        self.step, self.epoch = 0, -1
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
            loss, stats = self._train_step()
            done = self.step + 1
            tested, last = done in evaluations, done == self.options.steps
            noted = tested or done % every == 0
            # before the edits, as the field does: after a reset of opacities nothing is seen
            if noted and not last:
                self._record(done, loss, tested)
            self._edit(stats)
            self.step = done
            if noted and last:  # of what is kept
                self._record(done, loss, tested)
            n = len(self.field.params)
            self.progress.step(self.step, self.options.steps, loss, n, self.psnr)
            if self.keeper is not None and self.keeper.due():
                self.keeper.keep(self.state())
        self._tell_what_did_nothing()
        return Trained(
            self._evaluated(self.field.params.detach().to("cpu"), self.step),
            self.background,
            self._sh_degree(),
            tuple(self.history),
            self.watch.wall_s,
            self.watch.cpu_s,
            self.resumed,
            self.dose.kept(),
        )

    def _train_step(self) -> tuple[float, StepStats]:
        """Pick, render, lose, step. Returns the loss on the real view and what was seen of it.

        A pseudo view's own update comes before its real one: so every step, and the training, ends
        on a photo, and what the capacity plugin sees of it is of the Gaussians as they are.
        """
        real, *pseudo = self._pick()
        if self.options.pseudo_steps == "own":
            for turn, item in enumerate(pseudo, 1):
                self._update([item], turn)
            pseudo = []
        return self._update([real, *pseudo])

    def _update(self, items: list[Item], turn: int = 0) -> tuple[float, StepStats]:
        """One descent down the losses on `items`; the loss on the first, and what was seen of it.

        A second field takes the same, and each is shown what the other was before.
        """
        second = self.second
        if second is None:
            return self._descend(self.field, items, turn, None)
        before = self.field.params.clone()  # the second changes only after the first looked at it
        found = self._descend(self.field, items, turn, second.params.detach())
        self.seen_by_second = self._descend(second, items, turn, before)[1]
        return found

    def _descend(
        self, field: Field, items: list[Item], turn: int, other: Gaussians | None
    ) -> tuple[float, StepStats]:
        """Opacities fade in updates on real views alone: so much per step, whatever joins it."""
        rendered, options = self._rendered(), self.options
        now = self._now(turn, field, other, rendered["background"])
        rates = schedule.learning_rates(options, self.step, self.extent)
        if turn == 0:
            for lowered, names in field.plugins.substeps(now, field.params, items[0].view):
                substep(field.params, field.optimizer, lowered, names, self.step, rates)
        losses, stats = descend(
            field.params,
            field.optimizer,
            items,
            self.step,
            rates,
            Fading(options.opacity_decay, options.opacity_spare) if turn == 0 else Fading(),
            options.ssim_weight,
            field.plugins.regularization(now, field.params),
            field.plugins.gradients if turn == 0 else (),
            self.rasterizer,
            turn == 0 and field.plugins.absolute,
            **rendered,
        )
        if field is self.field:
            self.dose.add("steps")
            for item, loss in zip(items, losses, strict=True):
                self.dose.add("loss.pseudo" if item.view.pseudo else "loss.real", loss)
        return losses[0], stats

    def _pick(self) -> tuple[Item, ...]:
        """The epoch's next real view and the pseudo views of its step, at the current resolution;
        starts an epoch when needed."""
        if not self.queue:
            self.epoch += 1
            self.pseudo = self.field.plugins.pseudo_views(self._now())
            self.items.begin(self.pseudo)
            self.queue = self._ordered()
        real, *pseudo = (
            self.items.get(view, schedule.downsampling(self.options, self.step, view))
            for view in self.queue.pop()
        )
        if self.binocular is not None:
            real = replace(real, beside=self.binocular.beside(real.view, self.step))
        return real, *pseudo

    def _ordered(self) -> list[tuple[View, ...]]:
        """The epoch's steps in their order; the last one is taken first."""
        return ordered(self.training.views, self.pseudo, self.seed, self.epoch)

    def _rendered(self) -> dict[str, Any]:
        """How the step renders its views."""
        background = (
            random_background(self.seed, self.step) if self.random_background else self.background
        )
        return {"background": background, "sh_degree": self._sh_degree(), "near": self.near}

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugins change the set, and that of a second field, parameters and
        moments together. Edits make new tensors, so both are shown the other as it was."""
        if self.second is None:
            self._edit_field(self.field, stats, None)
            return
        before = self.field.params.detach(), self.second.params.detach()
        self._edit_field(self.field, stats, before[1])
        self._edit_field(self.second, self.seen_by_second, before[0])

    def _edit_field(self, field: Field, stats: StepStats, other: Gaussians | None) -> None:
        def apply(edits: Edits) -> tuple[Gaussians, Tensor | None]:
            rows = field.edit(edits, f"training step {self.step}")
            return field.params.detach(), rows

        field.plugins.edits(self._now(0, field, other), stats, apply)

    def _smoothness(self) -> DepthSmoothness | None:
        weight = self.options.depth_smoothness
        return DepthSmoothness(weight, self.conditions.spacing) if weight > 0 else None

    def _binocular(self) -> Binocular | None:
        weight, since = self.options.binocular, self.options.binocular_from
        if weight == 0:
            return None
        return Binocular(
            weight, self.conditions.spacing, math.ceil(since * self.options.steps), self.seed
        )

    def _sh_degree(self) -> int:
        stored = self.field.params.sh_degree
        return schedule.sh_degree(self.options, self.step, stored, self.sh_from)

    def _now(
        self,
        turn: int = 0,
        field: Field | None = None,
        other: Gaussians | None = None,
        behind: Tensor | None = None,
    ) -> Moment:
        """Where the training stands, as plugins see it."""
        of, degree = field or self.field, self._sh_degree()
        gaussians = of.params.detach()
        return Moment(self.step, self.epoch, of.version, gaussians, degree, turn, behind, other)

    def _evaluated(self, gaussians: Gaussians, done: int) -> Gaussians:
        """What is evaluated after `done` steps in the place of the field's, here on the CPU."""
        now = replace(self._now(behind=self.background), step=max(done - 1, 0))
        return self.field.plugins.evaluated(now, gaussians)

    def _record(self, done: int, loss: float, evaluating: bool) -> None:
        """A row of the history after `done` steps; on evaluation steps with the test PSNR."""
        psnr: float | None = None
        with self.watch.paused() as seconds:
            if evaluating and self.evaluate is not None:
                params = self.field.params.clone().to("cpu")
                gaussians = self._evaluated(params, done)
                psnr = self.evaluate(gaussians, self.background, self._sh_degree())
                self.psnr = psnr
        self.history.append(
            HistoryRow(
                step=done,
                seconds=seconds,
                loss=loss,
                gaussians=len(self.field.params),
                sh_degree=self._sh_degree(),
                test_psnr=psnr,
                logged=dict(self.field.plugins.logged),
            )
        )
        self.field.plugins.logged.clear()

    def state(self) -> TrainerState:
        """All that is needed to go on from here, with tensors that the next step changes."""
        return TrainerState(
            step=self.step,
            epoch=self.epoch,
            left=len(self.queue),
            field=self.field.state(),
            pseudo=tuple(self.pseudo),
            history=tuple(self.history),
            logged=dict(self.field.plugins.logged),
            dose=self.dose.kept(),
            psnr=self.psnr,
            wall_s=self.watch.wall_s,
            cpu_s=self.watch.cpu_s,
            resumed=self.resumed,
            second=None if self.second is None else self.second.state(),
        )

    def _take_up(self, state: TrainerState) -> None:
        self.step, self.epoch = state.step, state.epoch
        self.field.take_up(state.field, state.logged)
        if self.second is not None and state.second is not None:
            self.second.take_up(state.second)
        self.pseudo = list(state.pseudo)
        self.queue = self._ordered()[: state.left] if state.left else []
        self.dose.take_up(state.dose)
        self.history = list(state.history)
        self.psnr, self.resumed = state.psnr, state.resumed + 1
        self.watch = Stopwatch(state.wall_s, state.cpu_s)

    def _tell_what_did_nothing(self) -> None:
        if not self.tells:
            return
        stored = self.field.params.sh_degree
        active = schedule.sh_degree(self.options, self.options.steps - 1, stored, self.sh_from)
        if active < stored:
            LOG.warning(
                f"trainer.sh_degree={stored}: only degree {active} was ever active, as"
                f" {self.options.steps} steps are few for trainer.sh_every={self.options.sh_every};"
                " the other bands are stored and 0; raise trainer.steps or set trainer.sh_every=0,"
                " which is over half of them"
            )
        self.field.plugins.warn_of_no_effect()
