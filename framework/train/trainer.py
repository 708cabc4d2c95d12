"""The shared trainer: all methods of a study run this loop with the same options.

A training step renders the epoch's next view with the regularizers' opacity factors. It takes the
gradient of the photometric loss and of the regularizers' terms, and a step of Adam. Then the
capacity plugins edit the set of Gaussians. At the start of an epoch the augmenter may add pseudo
views. Each joins the step of one real view and adds its weighted loss, or has its own update before
that step (`trainer.pseudo_steps`).

A step is always one of a real view. So all methods take the same steps on the same real views.
Everything counted in steps (rates, SH bands, capacity, evaluations) means the same for all. The
paper counts pseudo views too: its T updates with one pseudo view per epoch of K photos are
T K / (K + 1) steps here.

The trainer has a `TrainingSet`, so test views cannot be reached from here; `evaluate` is a callback
that is given only the Gaussians.
"""

import logging
import math
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from framework.backends import NUMBA, Rasterizer
from framework.compute.stopwatch import Stopwatch
from framework.errors import require
from framework.initialize.background import background_color, random_background
from framework.options import TrainerOptions
from framework.plugin import Edits, StepStats
from framework.records.progress import Progress
from framework.records.run_files import HistoryRow
from framework.train import schedule
from framework.train.context import Conditions, Moment
from framework.train.depth_priors import Binocular, DepthSmoothness
from framework.train.descent import Fading, Update, descend, substep
from framework.train.dose import Dose
from framework.train.epoch import Item, Items, ordered
from framework.train.field import Field
from framework.train.gradient import Rendering
from framework.train.plugin_calls import PluginCalls
from framework.train.resume.checkpoint import Checkpoints
from framework.train.resume.training_state import Plugins, Trained, TrainerState
from framework.types import DepthMap, Gaussians, TrainingSet, View

LOG = logging.getLogger(__name__)
HISTORY_ROWS = 60  # per run, besides those of evaluations

Evaluate = Callable[[Gaussians, Tensor, int], float | None]


class Trainer:
    """One training; `run` may be called once.

    Args:
        evaluate: (gaussians, background [3], sh_degree) -> mean test PSNR in dB, or None. It gets
            copies at the evaluation steps, and its time does not count.
        keeper: is offered the state after every step.
        start: a kept state of the same training, to continue from.
        sh_from: SH degree that is active in the first step.
        warns: warn about methods without effect.
        rasterizer: renders; parameters and targets are on its device.
        second: initial Gaussians of a second field; by default those of the first.
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
        keeper: Checkpoints | None = None,
        start: TrainerState | None = None,
        sh_from: int = 0,
        warns: bool = True,
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
        self.warns, self.rasterizer = warns, rasterizer
        self.near, self.extent = options.near_plane * training.near, training.extent
        self.random_background = options.background == "random"
        self.background = background_color(options.background, training)
        self.conditions = Conditions(
            training, depth, options, self.background, self.near, seed, rasterizer
        )
        self.dose = Dose()
        self.field = Field.of(
            gaussians, PluginCalls(plugins, self.conditions, self.dose), rasterizer
        )
        require(
            rasterizer.single_pixels or not self.field.plugins.absolute,
            f"rasterizer={rasterizer.name}: expected one with gradients of single pixels, for the"
            " absolute gradients that a capacity requests; use rasterizer=numba, or turn that"
            " option off, for instance capacity.absolute=false",
        )
        self.second = self._second_field(plugins, gaussians, second)
        weight = options.depth_smoothness
        smooth = DepthSmoothness(weight, self.conditions.spacing) if weight > 0 else None
        self.items = Items(options.pseudo_mean == "covered", rasterizer, smooth)
        self.binocular = self._binocular()
        self.pseudo: list[View] = []
        self.queue: list[tuple[View, ...]] = []
        self.step, self.epoch = 0, -1
        self.history: list[HistoryRow] = []
        self.psnr: float | None = None
        self.watch, self.resumed = Stopwatch(), 0
        if start is not None:
            self._load(start)

    def _second_field(
        self, plugins: Plugins, gaussians: Gaussians, second: Gaussians | None
    ) -> Field | None:
        """The field that some regularizers train beside the first; None if none does."""
        if not plugins.second_field:
            return None
        if second is not None and torch.equal(second.means, gaussians.means):
            LOG.warning(
                "second_drawn: this init draws nothing, so the second field starts from the same"
                " Gaussians as the first"
            )
        calls = PluginCalls(plugins, replace(self.conditions, field="second/"), Dose())
        return Field.of(gaussians if second is None else second, calls, self.rasterizer)

    def run(self) -> Trained:
        """Train for `options.steps` steps.

        Raises:
            Diverged: loss, gradients or parameters stopped being finite.
        """
        evaluations = schedule.evaluation_steps(self.options)
        every = max(1, self.options.steps // HISTORY_ROWS)
        while self.step < self.options.steps:
            loss, stats = self._train_step()
            done = self.step + 1
            evaluates, last = done in evaluations, done == self.options.steps
            records = evaluates or done % every == 0
            # before the edits: right after an opacity reset nothing would be visible
            if records and not last:
                self._record(done, loss, evaluates)
            self._edit(stats)
            self.step = done
            if records and last:  # of the final Gaussians
                self._record(done, loss, evaluates)
            n = len(self.field.params)
            self.progress.step(self.step, self.options.steps, loss, n, self.psnr)
            if self.keeper is not None and self.keeper.due():
                self.keeper.keep(self.state())
        if self.warns:
            self._warn_of_no_effect()
        return Trained(
            self._evaluated(self.field.params.detach().to("cpu"), self.step),
            self.background,
            self._sh_degree(),
            tuple(self.history),
            self.watch.wall_s,
            self.watch.cpu_s,
            self.resumed,
            dict(self.dose),
        )

    def _train_step(self) -> tuple[float, StepStats]:
        """Pick, render and step; returns the loss on the real view and its stats.

        A pseudo view's own update comes before the real one, so every step ends on a photo, and
        capacity plugins see stats of the current Gaussians.
        """
        real, *pseudo = self._pick()
        if self.options.pseudo_steps == "own":
            for turn, item in enumerate(pseudo, 1):
                self._update([item], turn)
            pseudo = []
        return self._update([real, *pseudo])

    def _update(self, items: list[Item], turn: int = 0) -> tuple[float, StepStats]:
        """Update both fields; returns the loss on the first view and its stats.

        Each field is shown the state of the other before the update.
        """
        second = self.second
        if second is None:
            return self._descend(self.field, items, turn, None)
        before = self.field.params.clone()
        result = self._descend(self.field, items, turn, second.params.detach())
        self.seen_by_second = self._descend(second, items, turn, before)[1]
        return result

    def _descend(
        self, field: Field, items: list[Item], turn: int, other: Gaussians | None
    ) -> tuple[float, StepStats]:
        """Opacity decay is applied once per real view, not for pseudo views (turn > 0)."""
        options, rendering, real = self.options, self._rendering(), turn == 0
        now = self._now(turn, field, other, rendering.background)
        rates = schedule.learning_rates(options, self.step, self.extent)
        if real:
            for lowered, names in field.plugins.substeps(now, field.params, items[0].view):
                substep(field.params, field.optimizer, lowered, names, self.step, rates)
        update = Update(
            self.step,
            rates,
            rendering,
            field.plugins.regularization(now, field.params),
            Fading(options.opacity_decay, options.opacity_spare) if real else Fading(),
            field.plugins.gradients if real else (),
            real and field.plugins.absolute,
        )
        losses, stats = descend(field.params, field.optimizer, items, update)
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
        """The epoch's steps; the last one is taken first."""
        return ordered(self.training.views, self.pseudo, self.seed, self.epoch)

    def _rendering(self) -> Rendering:
        """How the step renders its views."""
        background = (
            random_background(self.seed, self.step) if self.random_background else self.background
        )
        return Rendering(
            background,
            self._sh_degree(),
            self.near,
            ssim_weight=self.options.ssim_weight,
            rasterizer=self.rasterizer,
        )

    def _edit(self, stats: StepStats) -> None:
        """Let the capacity plugins change both fields. Each is shown the previous other one;
        edits make new tensors."""
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

    def _binocular(self) -> Binocular | None:
        weight, since = self.options.binocular, self.options.binocular_from
        if weight == 0:
            return None
        first = math.ceil(since * self.options.steps)
        return Binocular(weight, self.conditions.spacing, first, self.seed)

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
        """The training at this moment, as plugins see it."""
        field = field or self.field
        return Moment(
            self.step,
            self.epoch,
            field.version,
            field.params.detach(),
            self._sh_degree(),
            turn,
            behind,
            other,
        )

    def _evaluated(self, gaussians: Gaussians, done: int) -> Gaussians:
        """The Gaussians that are evaluated after `done` steps, on the CPU."""
        now = replace(self._now(behind=self.background), step=max(done - 1, 0))
        return self.field.plugins.evaluated(now, gaussians)

    def _record(self, done: int, loss: float, evaluates: bool) -> None:
        """Append a row to the history after `done` steps, with the test PSNR if it evaluates."""
        psnr: float | None = None
        with self.watch.paused() as seconds:
            if evaluates and self.evaluate is not None:
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
        """Everything needed to continue from here; the next step changes its tensors."""
        return TrainerState(
            step=self.step,
            epoch=self.epoch,
            left=len(self.queue),
            field=self.field.state(),
            pseudo=tuple(self.pseudo),
            history=tuple(self.history),
            logged=dict(self.field.plugins.logged),
            dose=dict(self.dose),
            psnr=self.psnr,
            wall_s=self.watch.wall_s,
            cpu_s=self.watch.cpu_s,
            resumed=self.resumed,
            second=None if self.second is None else self.second.state(),
        )

    def _load(self, state: TrainerState) -> None:
        self.step, self.epoch = state.step, state.epoch
        self.field.load(state.field, state.logged)
        if self.second is not None and state.second is not None:
            self.second.load(state.second)
        self.pseudo = list(state.pseudo)
        self.queue = self._ordered()[: state.left] if state.left else []
        self.dose.update(state.dose)
        self.history = list(state.history)
        self.psnr, self.resumed = state.psnr, state.resumed + 1
        self.watch = Stopwatch(state.wall_s, state.cpu_s)

    def _warn_of_no_effect(self) -> None:
        stored = self.field.params.sh_degree
        active = schedule.sh_degree(self.options, self.options.steps - 1, stored, self.sh_from)
        if active < stored:
            LOG.warning(
                f"trainer.sh_degree={stored}: only degree {active} was active, because"
                f" {self.options.steps} steps are few for trainer.sh_every={self.options.sh_every};"
                " the other bands are stored and 0; raise trainer.steps or set trainer.sh_every=0"
            )
        self.field.plugins.warn_of_no_effect()
