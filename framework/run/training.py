"""The training of one run: from the scene and its depth to the trained Gaussians.

An interrupted training continues from its last checkpoint and ends with the same bits. One that
diverged leaves its state in `diverged.safetensors`.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from framework import registry
from framework.backends import NUMBA, Rasterizer
from framework.compute.parallel import run_tasks, run_together, threads
from framework.compute.stopwatch import Stopwatch
from framework.depth.exposure import Exposures
from framework.errors import plugin_call
from framework.files.whole import write_whole
from framework.metrics.evaluate import psnr
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.plugin import Augmenter
from framework.records.progress import Part as PartProgress
from framework.records.progress import Parts, Progress, Silent
from framework.records.record import DIVERGED
from framework.registry import ActivePlugin
from framework.run import answers, budget
from framework.run.members import IDLE, in_turn, join, member_seed, second_seed, tuning_options
from framework.run.student import after_lesson, student_options, teacher
from framework.shapes import check_gaussians
from framework.train import schedule
from framework.train.guard import Diverged
from framework.train.resume.checkpoint import Checkpoints, pack, remove_checkpoints
from framework.train.resume.state_check import check_state
from framework.train.trainer import Evaluate, Plugins, Trained, Trainer
from framework.types import Camera, DepthMap, Gaussians, Render, Scene

LOG = logging.getLogger(__name__)
BYTES_PER_FLOAT, COPIES = 4, 3  # of every parameter: itself and two moments
DIVERGING = threading.Lock()  # members may diverge at the same time, into one file


@dataclass(frozen=True)
class Run:
    """Inputs of all trainings of a run.

    Attributes:
        scene: the scene, with equalized exposures if `exposures` is given.
        start: makes the initial Gaussians for a seed.
        force: ignore checkpoints in `folder`.
    """

    scene: Scene
    depth: tuple[DepthMap, ...]
    start: Callable[[int], Gaussians]
    folder: Path
    identity: str
    force: bool
    rasterizer: Rasterizer = NUMBA
    exposures: Exposures | None = None

    def near(self, options: TrainerOptions) -> float:
        """The near plane in scene units."""
        return options.near_plane * self.scene.training.near

    def test_psnr(self, options: TrainerOptions) -> Evaluate | None:
        """A function for the mean PSNR over the test views in dB; None without test views."""
        test = self.scene.test
        if not test:
            return None

        def evaluate(gaussians: Gaussians, background: Tensor, sh_degree: int) -> float | None:
            model, near = (gaussians, background, sh_degree), self.near(options)
            render = renderer(*model, near, self.rasterizer, self.exposures)
            images = [render(view.camera) for view in test]
            pairs = zip(images, test, strict=True)
            values = run_tasks([partial(psnr, image, v.image, v.mask) for image, v in pairs])
            finite = [value for value in values if not isinstance(value, Missing)]
            return sum(finite) / len(finite) if len(finite) == len(values) else None

        return evaluate


class Part:
    """One of the trainings of a run: its only one, a member, the tuning of joined members, or the
    student's.

    Attributes:
        name: name of its checkpoint folder.
        kept: state of its newest checkpoint; None for a new training.
    """

    def __init__(
        self,
        run: Run,
        name: str,
        choices: Mapping[str, Mapping[str, Any]],
        options: TrainerOptions,
        seed: int,
        *,
        warns: bool,
        keeps_end: bool = False,
    ) -> None:
        self.run, self.name, self.options, self.seed = run, name, options, seed
        self.warns, self.keeps_end = warns, keeps_end
        self.plugins = Plugins.of(choices)
        with plugin_call("capacity: shared"):
            n_kept = options.kept if schedule.taught(options) else options.members
            self.plugins = self.plugins.shared(n_kept)
        plugins = {key: one.plugin for key, one in self.plugins.each.items()}
        self.checkpoints = Checkpoints(run.folder, run.identity, plugins.values(), name)
        check = partial(check_state, training=run.scene.training, options=options, plugins=plugins)
        self.kept = self.checkpoints.newest(check)
        self.done = 0 if self.kept is None else self.kept.step

    def train(
        self,
        gaussians: Gaussians,
        progress: Progress,
        resumed: int,
        sh_from: int,
        augmenter: Augmenter | None = None,
    ) -> Trained:
        """Train, or continue from the newest checkpoint.

        Args:
            gaussians: the initial ones.
            progress: shows the steps.
            resumed: how often the run was resumed.
            sh_from: SH degree that is active in the first step.
            augmenter: replaces the part's own.
        """
        run, checkpoints, plugins = self.run, self.checkpoints, self.plugins
        if augmenter is not None:
            plugins = Plugins({**plugins.each, "augment": ActivePlugin(augmenter)})
        checkpoints.begin(COPIES * BYTES_PER_FLOAT * sum(t.numel() for _, t in gaussians.items()))
        second = run.start(second_seed(self.seed)) if self.plugins.second_drawn else None
        trainer = Trainer(
            run.scene.training,
            run.depth,
            gaussians,
            self.options,
            plugins,
            self.seed,
            progress,
            evaluate=run.test_psnr(self.options),
            keeper=checkpoints,
            start=self.kept,
            sh_from=sh_from,
            warns=self.warns,
            rasterizer=run.rasterizer,
            second=second,
        )
        self.kept = None  # the trainer has its own copies
        del gaussians, second
        trainer.resumed = resumed
        try:
            trained = trainer.run()
        except Diverged as error:
            state = pack(error.state, checkpoints.classes, run.identity, "diverged state")
            with DIVERGING:
                write_whole(run.folder / DIVERGED, state)
            name = f"{self.name}, " if self.name else ""
            error.args = (f"{name}{error}; the state is in {run.folder.name}/{DIVERGED}",)
            raise
        if self.keeps_end and self.done < self.options.steps:
            checkpoints.keep(trainer.state())
        return trained


class _Trainings:
    """The trainings of a run, as parts of one progress display.

    Attributes:
        starts: initial Gaussians of the parts; each is dropped when its training has copied it.
    """

    def __init__(self, run: Run, parts: Sequence[Part], progress: Progress) -> None:
        self.run, self.parts, self.progress = run, parts, progress
        self.resumed = _resumed(parts, progress)
        n_steps = sum(part.options.steps for part in parts)
        self.whole = Parts(progress, n_steps, [part.done for part in parts])
        self.starts = dict[int, Gaussians]()

    def train(
        self,
        k: int,
        check: Callable[[], None] = lambda: None,
        sh_from: int = 0,
        augmenter: Augmenter | None = None,
    ) -> Trained:
        """Train part `k` from `starts[k]`; `check` raises if another part has failed."""
        progress = PartProgress(self.whole, k, check)
        return self.parts[k].train(self.starts.pop(k), progress, self.resumed, sh_from, augmenter)

    def members(self, n: int) -> list[list[Trained]]:
        """Train the `n` members; those that were trained at the same time are a list."""
        rounds, at_once = list[list[Trained]](), threads() if threads() < 2 * n else 1
        for first in range(0, n, at_once):
            members = range(first, min(n, first + at_once))
            if n > 1:
                names = ", ".join(str(k + 1) for k in members)
                self.progress.stage(f"members {names} of {n}")
            self.starts.update((k, self.run.start(self.parts[k].seed)) for k in members)
            rounds.append(run_together([partial(self.train, k) for k in members]))
        return rounds

    def student(self, gaussians: Gaussians, degree: int, members: Sequence[Trained]) -> Trained:
        """Train the last part, the student of the joined `gaussians`, from `members`."""
        self.progress.stage("a student of the members")
        watch, last, run = Stopwatch(), len(self.parts) - 1, self.run
        near = run.near(self.parts[0].options)
        render = thinned(gaussians, members[0].background, degree, near, run.rasterizer)
        augmenter = teacher(run.scene.training, render, self.parts[0].seed)
        self.starts[last] = join([member.gaussians for member in members])
        prepared_s = watch.wall_s, watch.cpu_s
        return after_lesson(self.train(last, sh_from=degree, augmenter=augmenter), *prepared_s)


def train(run: Run, config: Mapping[str, Any], progress: Progress) -> Trained:
    """Train, or continue an interrupted training.

    With `trainer.members` > 1 several trainings run, each with its own draws, and their Gaussians
    are joined and tuned, so errors made by chance average out. The first equals a run with one
    member. With `trainer.kept` they then teach a student, which is the result. As many members
    train at the same time as there are threads, with one thread each, unless there are two threads
    for each: then one after another with all threads.

    Raises:
        Diverged: a training diverged; its state is in the run's folder.
    """
    if run.force:
        remove_checkpoints(run.folder)
    options = _paced(run, config, progress)
    for line in schedule.inert(options):
        LOG.warning(line)
    n, trainings = options.members, _Trainings(run, _parts(run, config, options), progress)
    rounds = trainings.members(n)
    if n == 1:
        return rounds[0][0]
    members = [member for at_once in rounds for member in at_once]
    gaussians = join([member.gaussians for member in members])
    # a member may have lost all its bands (capacity=evidence); the others keep theirs
    degree = max(member.sh_degree for member in members)
    if len(trainings.parts) == n:
        joined = replace(in_turn(rounds, gaussians), sh_degree=degree)
        return _evaluated(run, joined, options)
    if options.tuning > 0:
        progress.stage("tuning of the members together")
        trainings.starts[n] = gaussians
        rounds.append([trainings.train(n, sh_from=degree)])
        gaussians = rounds[-1][0].gaussians
    if schedule.taught(options):
        rounds.append([trainings.student(gaussians, degree, members[: options.kept])])
    return in_turn(rounds, rounds[-1][0].gaussians)


def within_seconds(
    run: Run, config: Mapping[str, Any], progress: Progress
) -> tuple[Mapping[str, Any], dict[str, Any] | None]:
    """Choose the steps that fit into `trainer.seconds`.

    Returns:
        The configuration with these steps, and the choice for the record; the same configuration
        and None without a time limit.
    """
    options = TrainerOptions(**config["trainer"])
    if options.seconds <= 0:
        return config, None
    progress.stage(f"choosing steps for {options.seconds:g} s")
    if run.force:
        (run.folder / budget.FILE).unlink(missing_ok=True)
    choice = budget.chosen(
        run.folder,
        run.identity,
        options,
        len(run.scene.training.views),
        lambda trial: try_out(run, config, trial).wall_s,
    )
    progress.note(f"{choice.seconds:g} s of training: {choice.record['repeat']}")
    return {**config, "trainer": asdict(choice.applied(options))}, choice.record


def try_out(run: Run, config: Mapping[str, Any], options: TrainerOptions) -> Trained:
    """Train once with other options, without evaluations; nothing is kept."""
    seed = int(config["seed"])
    return Trainer(
        run.scene.training,
        run.depth,
        run.start(seed),
        schedule.paced(options, len(run.scene.training.views)),
        Plugins.of(config),
        seed,
        Silent(),
        warns=False,
        rasterizer=run.rasterizer,
    ).run()


def initial(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    options: TrainerOptions,
    seed: int,
) -> Gaussians:
    """Make the initial Gaussians with the chosen initializer."""
    builder, degree = registry.part("init", config["init"]), options.sh_degree
    return answers.ask(
        f"init={config['init']['name']}: build",
        builder,
        partial(builder.build, scene.training, depth, degree, seed),
        lambda value: check_gaussians("the Gaussians", value, None, (degree + 1) ** 2 - 1),
    )


def _paced(run: Run, config: Mapping[str, Any], progress: Progress) -> TrainerOptions:
    """The options of one member, with steps and rates adapted to the number of photos."""
    n_views, values = len(run.scene.training.views), TrainerOptions(**config["trainer"])
    options = schedule.paced(schedule.shared(values, n_views), n_views)
    if options.steps > values.steps:
        progress.note(
            f"{options.steps} steps instead of trainer.steps={values.steps}: trainer.visits="
            f"{options.visits} of each of {n_views} photos"
        )
    if values.kept > TrainerOptions.kept and not schedule.taught(options):
        LOG.warning(
            f"trainer.kept={values.kept}: with {options.members} trainings there is none whose"
            " Gaussians could be left out, so it has no effect; set trainer.members="
            f"{values.kept + 1} or more"
        )
    return options


def _parts(run: Run, config: Mapping[str, Any], options: TrainerOptions) -> list[Part]:
    """The members of a run and, if there are several, their tuning and their student."""
    seed, n = int(config["seed"]), options.members
    if n == 1:
        return [Part(run, "", config, options, seed, warns=True)]
    parts = [
        Part(
            run,
            f"member {k + 1}",
            config,
            options,
            member_seed(seed, k),
            warns=k == n - 1,
            keeps_end=True,
        )
        for k in range(n)
    ]
    taught = schedule.taught(options)
    if options.tuning > 0:
        tuned = tuning_options(options, max(1, round(options.tuning * options.steps)))
        parts.append(Part(run, "tuning", IDLE, tuned, seed, warns=False, keeps_end=taught))
    if taught:
        parts.append(Part(run, "student", IDLE, student_options(options), seed, warns=False))
    return parts


def _resumed(parts: Sequence[Part], progress: Progress) -> int:
    """How often the run was resumed, this time included; 0 for a new one."""
    kept = [part.kept for part in parts if part.kept is not None]
    if not kept:
        return 0
    done, n_steps = sum(part.done for part in parts), sum(part.options.steps for part in parts)
    progress.note(f"going on at step {done} of {n_steps}")
    return 1 + max(state.resumed for state in kept)


def _evaluated(run: Run, joined: Trained, options: TrainerOptions) -> Trained:
    """`joined` with a history that ends with the joined Gaussians."""
    evaluate = run.test_psnr(options)
    result = evaluate and evaluate(joined.gaussians, joined.background, joined.sh_degree)
    last = replace(joined.history[-1], test_psnr=result, gaussians=len(joined.gaussians))
    return replace(joined, history=(*joined.history[:-1], last))


def renderer(
    gaussians: Gaussians,
    background: Tensor,
    sh_degree: int,
    near: float,
    rasterizer: Rasterizer = NUMBA,
    exposures: Exposures | None = None,
) -> Callable[[Camera], Tensor]:
    """Return a function that renders a camera's image [3, H, W] for evaluation, on the CPU.

    With `exposures` the image is exposed like the photos around the camera.
    """
    draw = thinned(gaussians, background, sh_degree, near, rasterizer)
    if exposures is None:
        return lambda camera: draw(camera, None).rgb
    return lambda camera: exposures.applied(draw(camera, None).rgb, camera)


def thinned(
    gaussians: Gaussians,
    background: Tensor,
    sh_degree: int,
    near: float,
    rasterizer: Rasterizer,
) -> Callable[[Camera, Tensor | None], Render]:
    """Return a function that renders with opacities multiplied by factors [N], or None."""
    placed = gaussians.detach().to(rasterizer.device)

    def render(camera: Camera, factors: Tensor | None) -> Render:
        image = rasterizer.render(
            placed,
            camera,
            background=background,
            sh_degree=sh_degree,
            near=near,
            opacity_factors=None if factors is None else factors.to(rasterizer.device),
            depth=False,
        )
        return replace(
            image, rgb=image.rgb.detach().to("cpu"), alpha=image.alpha.detach().to("cpu")
        )

    return render
