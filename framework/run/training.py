"""One run's training: from the scene and its depth to the trained Gaussians, kept on the way.

A training that was interrupted goes on from its last checkpoint and ends with the same bits; one
that diverged leaves its state in `diverged.safetensors`.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from framework import registry
from framework.backends import NUMBA, Rasterizer
from framework.compute.parallel import run_tasks, run_together, threads
from framework.depth.exposure import Exposures
from framework.errors import plugin_call
from framework.files.whole import write_whole
from framework.metrics.evaluate import psnr
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.plugin import Plugin
from framework.records.progress import Part, Parts, Progress, Silent
from framework.records.record import DIVERGED
from framework.run import answers
from framework.run.members import (
    IDLE,
    in_turn,
    join,
    member_seed,
    second_seed,
    tuning_options,
)
from framework.train import schedule
from framework.train.guard import Diverged
from framework.train.resume.checkpoint import Checkpoints, pack, remove_checkpoints
from framework.train.resume.state_check import check_state
from framework.train.resume.training_state import TrainerState
from framework.train.trainer import Evaluate, Plugins, Trained, Trainer
from framework.types import Camera, DepthMap, Gaussians, Render, Scene

LOG = logging.getLogger(__name__)
BYTES_PER_FLOAT, COPIES = 4, 3  # of every parameter: itself and two moments
DIVERGING = threading.Lock()  # members may diverge at the same time, into one file


def initial(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    options: TrainerOptions,
    seed: int,
) -> Gaussians:
    """The Gaussians that the chosen initializer starts from."""
    builder = registry.part("init", config["init"])
    with answers.called(f"init={config['init']['name']}: build", type(builder)):
        gaussians: Gaussians = builder.build(scene.training, depth, options.sh_degree, seed)
    return answers.gaussians(config["init"]["name"], type(builder), gaussians, options.sh_degree)


@dataclass(frozen=True)
class _Part:
    """A training of its own within a run. name: of its checkpoints. choices: of the plugin groups.
    tells: see `Trainer`. to_keep: its end is kept, for a later process."""

    name: str
    choices: Mapping[str, Mapping[str, Any]]
    options: TrainerOptions
    seed: int
    tells: bool = True
    to_keep: bool = False


@dataclass(frozen=True)
class _Opened:
    """A part with its plugins and checkpoints, and the state that an earlier process kept."""

    part: _Part
    plugins: Plugins
    checkpoints: Checkpoints
    kept: TrainerState | None

    @property
    def done(self) -> int:
        """Steps that are behind it."""
        return 0 if self.kept is None else self.kept.step


@dataclass(frozen=True)
class Run:
    """What the parts of a run have in common.

    scene: its training photos are evened by `exposures`, if there are any. start(seed) makes the
    Gaussians to begin with, which nobody else keeps then. force: go on with nothing that an
    interrupted process left in `folder` under this identity.
    """

    scene: Scene
    depth: tuple[DepthMap, ...]
    start: Callable[[int], Gaussians]
    folder: Path
    identity: str
    force: bool
    rasterizer: Rasterizer = NUMBA
    exposures: Exposures | None = None


def train(run: Run, config: Mapping[str, Any], progress: Progress) -> Trained:
    """Train, or go on with what an interrupted process left.

    With `trainer.members` > 1 there are several trainings, each from its own draws, whose Gaussians
    are joined and tuned: what one of them got wrong by chance weighs less. The first is that of a
    run with one member. As many as there are threads are trained at the same time, one thread each,
    which takes less time than all threads for one after another, unless there are two for each.
    Raises Diverged when a training diverges; the state is in the run's folder then.
    """
    if run.force:
        remove_checkpoints(run.folder)
    n_views = len(run.scene.training.views)
    options = schedule.paced(schedule.shared(TrainerOptions(**config["trainer"]), n_views), n_views)
    if options.steps > (asked := config["trainer"]["steps"]):
        progress.note(
            f"{options.steps} steps instead of trainer.steps={asked}: trainer.visits="
            f"{options.visits} of each of {n_views} photos"
        )
    for line in schedule.inert(options):
        LOG.warning(line)
    parts = _parts(config, options)
    opened = {index: _open(run, part) for index, part in enumerate(parts)}
    kept = [part.kept for part in opened.values() if part.kept is not None]
    n_steps, done = sum(part.options.steps for part in parts), sum(state.step for state in kept)
    resumed = 1 + max(state.resumed for state in kept) if kept else 0
    if kept:
        progress.note(f"going on at step {done} of {n_steps}")
    whole = Parts(progress, n_steps, [part.done for part in opened.values()])
    del kept  # each is its training's, and goes with it
    starts = dict[int, Gaussians]()

    def task(index: int, check: Callable[[], None], sh_from: int = 0) -> Trained:
        part = Part(whole, index, check)
        return _train(run, opened.pop(index), starts.pop(index), part, resumed, sh_from)

    n, rounds = options.members, list[list[Trained]]()
    at_once = threads() if threads() < 2 * n else 1
    for first in range(0, n, at_once):
        members = range(first, min(n, first + at_once))
        if n > 1:
            progress.stage(f"members {', '.join(str(k + 1) for k in members)} of {n}")
        starts.update((k, run.start(parts[k].seed)) for k in members)
        rounds.append(run_together([partial(task, k) for k in members]))
    if n == 1:
        return rounds[0][0]
    gaussians = join([member.gaussians for members in rounds for member in members])
    # of one that lost all of its bands, as evidence may decide, the others' must not go
    degree = max(member.sh_degree for members in rounds for member in members)
    if len(parts) == n:
        together = replace(in_turn(rounds, options.steps, gaussians), sh_degree=degree)
        return _untuned(run, together, options)
    progress.stage("tuning of the members together")
    starts[n] = gaussians
    tuned = task(n, lambda: None, sh_from=degree)
    return in_turn([*rounds, [tuned]], options.steps, tuned.gaussians)


def try_out(run: Run, config: Mapping[str, Any], options: TrainerOptions) -> Trained:
    """One training with other options, without a look at the test views; nothing of it is kept."""
    plugins = Plugins.of(config)
    seed, n_views = int(config["seed"]), len(run.scene.training.views)
    return Trainer(
        run.scene.training,
        run.depth,
        run.start(seed),
        schedule.paced(options, n_views),
        plugins,
        seed,
        Silent(),
        tells=False,
        rasterizer=run.rasterizer,
    ).run()


def _parts(config: Mapping[str, Any], options: TrainerOptions) -> list[_Part]:
    """The members of a run, and their tuning if there is any."""
    seed, n = int(config["seed"]), options.members
    if n == 1:
        return [_Part("", config, options, seed)]
    parts = [
        _Part(
            f"member {k + 1}",
            config,
            options,
            member_seed(seed, k),
            tells=k == n - 1,
            to_keep=True,
        )
        for k in range(n)
    ]
    if options.tuning > 0:
        tuned = tuning_options(options, max(1, round(options.tuning * options.steps)))
        parts.append(_Part("tuning", IDLE, tuned, seed, tells=False))
    return parts


def _untuned(run: Run, joined: Trained, options: TrainerOptions) -> Trained:
    """`joined` with a history that ends with what the joined Gaussians are."""
    evaluate = _evaluation(run, options)
    found = evaluate and evaluate(joined.gaussians, joined.background, joined.sh_degree)
    last = replace(joined.history[-1], test_psnr=found, gaussians=len(joined.gaussians))
    return replace(joined, history=(*joined.history[:-1], last))


def _open(run: Run, part: _Part) -> _Opened:
    """The part with what an earlier process kept of it."""
    plugins = Plugins.of(part.choices)
    with plugin_call("capacity: shared"):
        plugins = plugins.shared(part.options.members)
    chosen: dict[str, Plugin] = {key: one.plugin for key, one in plugins.each.items()}
    checkpoints = Checkpoints(run.folder, run.identity, chosen.values(), part.name)
    check = partial(check_state, training=run.scene.training, options=part.options, plugins=chosen)
    return _Opened(part, plugins, checkpoints, checkpoints.newest(check))


def _train(
    run: Run,
    opened: _Opened,
    gaussians: Gaussians,
    progress: Progress,
    resumed: int,
    sh_from: int,
) -> Trained:
    """One part, or what is left of it to do. resumed: how often the run was taken up again.
    sh_from: see `Trainer`."""
    part, checkpoints, kept = opened.part, opened.checkpoints, opened.kept
    checkpoints.begin(COPIES * BYTES_PER_FLOAT * sum(t.numel() for _, t in gaussians.items()))
    trainer = Trainer(
        run.scene.training,
        run.depth,
        gaussians,
        part.options,
        opened.plugins,
        part.seed,
        progress,
        _evaluation(run, part.options),
        checkpoints,
        kept,
        sh_from,
        part.tells,
        run.rasterizer,
        run.start(second_seed(part.seed)) if opened.plugins.second_drawn else None,
    )
    del gaussians  # the trainer has its own
    trainer.resumed = resumed
    try:
        trained = trainer.run()
    except Diverged as error:
        state = pack(error.state, checkpoints.classes, run.identity, "diverged state")
        with DIVERGING:
            write_whole(run.folder / DIVERGED, state)
        name = f"{part.name}, " if part.name else ""
        error.args = (f"{name}{error}; the state is in {run.folder.name}/{DIVERGED}",)
        raise
    if part.to_keep and opened.done < part.options.steps:
        checkpoints.keep(trainer.state())
    return trained


def _evaluation(run: Run, options: TrainerOptions) -> Evaluate | None:
    """Mean PSNR over the test views in dB, if there are any; None where one of them has none."""
    scene = run.scene
    if not scene.test:
        return None
    near = options.near_plane * scene.training.near

    def test_psnr(current: Gaussians, background: Tensor, sh_degree: int) -> float | None:
        seen = current, background, sh_degree
        render = renderer(*seen, near, run.rasterizer, run.exposures)
        images = [render(view.camera) for view in scene.test]
        pairs = zip(images, scene.test, strict=True)
        values = run_tasks([partial(psnr, image, view.image, view.mask) for image, view in pairs])
        finite = [value for value in values if not isinstance(value, Missing)]
        return sum(finite) / len(finite) if len(finite) == len(values) else None

    return test_psnr


def renderer(
    gaussians: Gaussians,
    background: Tensor,
    sh_degree: int,
    near: float,
    rasterizer: Rasterizer = NUMBA,
    exposures: Exposures | None = None,
) -> Callable[[Camera], Tensor]:
    """What evaluation sees: the Gaussians alone, without plugins or gradients, exposed as photos
    around were. Images are on the CPU."""
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
    """As `renderer`, with opacities times factors [N] if there are any, and with alpha."""
    placed = gaussians.detach().to(rasterizer.device)

    def render(camera: Camera, factors: Tensor | None) -> Render:
        seen = rasterizer.render(
            placed,
            camera,
            background=background,
            sh_degree=sh_degree,
            near=near,
            opacity_factors=None if factors is None else factors.to(rasterizer.device),
            depth=False,
        )
        return replace(seen, rgb=seen.rgb.detach().to("cpu"), alpha=seen.alpha.detach().to("cpu"))

    return render
