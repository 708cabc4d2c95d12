"""One run's training: from the scene and its depth to the trained Gaussians, kept on the way.

A training that was interrupted goes on from its last checkpoint and ends with the same bits; one
that diverged leaves its state in `diverged.safetensors`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from torch import Tensor

from framework import registry
from framework.checkpoint import Checkpoints, pack, remove_checkpoints, state_classes
from framework.files import write_whole
from framework.guard import Diverged
from framework.initialize import INITIALIZERS
from framework.members import IDLE, in_turn, join, member_seed, tuning_options
from framework.metrics import Missing, psnr
from framework.options import TrainerOptions
from framework.plugin import Plugin
from framework.progress import Part, Progress
from framework.rasterize import rasterize
from framework.record import DIVERGED
from framework.state_check import check_state
from framework.trainer import Evaluate, Plugins, Trained, Trainer
from framework.types import Camera, DepthMap, Gaussians, Scene

BYTES_PER_FLOAT, COPIES = 4, 3  # of every parameter: itself and two moments


def initial(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    options: TrainerOptions,
    seed: int,
) -> Gaussians:
    """The Gaussians that the chosen initializer starts from."""
    rest = dict(config["init"])
    builder = INITIALIZERS[rest.pop("name")](**rest)
    gaussians: Gaussians = builder.build(scene.training, depth, options.sh_degree, seed)
    return gaussians


@dataclass(frozen=True)
class _Part:
    """A training of its own within a run. name: of its checkpoints. choices: of the plugin groups.
    again: whether the part before was read back. to_keep: its end is kept, for a later process.
    progress: see `Trainer`, as are sh_from and tells."""

    name: str
    choices: Mapping[str, Mapping[str, Any]]
    options: TrainerOptions
    seed: int
    progress: Progress
    sh_from: int = 0
    tells: bool = True
    again: bool = False
    to_keep: bool = False


@dataclass(frozen=True)
class Run:
    """What the parts of a run have in common.

    start(seed) makes the Gaussians to begin with, which nobody else keeps then. force: go on with
    nothing that an interrupted process left in `folder` under this identity.
    """

    scene: Scene
    depth: tuple[DepthMap, ...]
    start: Callable[[int], Gaussians]
    folder: Path
    identity: str
    force: bool


def train(run: Run, config: Mapping[str, Any], progress: Progress) -> Trained:
    """Train, or go on with what an interrupted process left.

    With `trainer.members` > 1 several trainings follow each other, each from its own draws, whose
    Gaussians are joined and tuned: what one of them got wrong by chance weighs less. The first is
    that of a run with one member. Raises Diverged when a training diverges; the state is in the
    run's folder then.
    """
    if run.force:
        remove_checkpoints(run.folder)
    options, seed = TrainerOptions(**config["trainer"]), int(config["seed"])
    if options.members == 1:
        return _train(run, _Part("", config, options, seed, progress), run.start(seed))[0]
    tuned = max(1, round(options.tuning * options.steps)) if options.tuning > 0 else 0
    n_steps, again = options.members * options.steps + tuned, False
    members = []
    for k in range(options.members):
        progress.stage(f"member {k + 1} of {options.members}")
        own = _Part(
            f"member {k + 1}",
            config,
            options,
            member_seed(seed, k),
            Part(progress, k * options.steps, n_steps),
            tells=k == options.members - 1,
            again=again,
            to_keep=True,
        )
        member, again = _train(run, own, run.start(own.seed))
        members.append(member)
    gaussians = join([member.gaussians for member in members])
    if tuned == 0:
        return _untuned(run, in_turn(members, options.steps, gaussians), options)
    progress.stage("tuning of the members together")
    own = _Part(
        "tuning",
        IDLE,
        tuning_options(options, tuned),
        seed,
        Part(progress, options.members * options.steps, n_steps),
        sh_from=members[-1].sh_degree,
        tells=False,
        again=again,
    )
    trained, _ = _train(run, own, gaussians)
    return in_turn([*members, trained], options.steps, trained.gaussians)


def _untuned(run: Run, joined: Trained, options: TrainerOptions) -> Trained:
    """`joined` with a history that ends with what the joined Gaussians are."""
    evaluate = _evaluation(run.scene, options)
    found = evaluate and evaluate(joined.gaussians, joined.background, joined.sh_degree)
    last = replace(joined.history[-1], test_psnr=found, gaussians=len(joined.gaussians))
    return replace(joined, history=(*joined.history[:-1], last))


def _train(run: Run, part: _Part, gaussians: Gaussians) -> tuple[Trained, bool]:
    """One part, or what is left of it to do; and whether nothing was left."""
    options = part.options
    plugins = Plugins(*(registry.build(group, part.choices[group]) for group in registry.GROUPS))
    chosen: list[Plugin] = [p.plugin for p in (plugins.augment, plugins.reg, plugins.capacity)]
    size = COPIES * BYTES_PER_FLOAT * sum(tensor.numel() for _, tensor in gaussians.items())
    checkpoints = Checkpoints(run.folder, run.identity, chosen, size, part.name)
    by_group = dict(zip(registry.GROUPS, chosen, strict=True))
    check = functools.partial(
        check_state, training=run.scene.training, options=options, plugins=by_group
    )
    kept = checkpoints.newest(check)
    ended = kept is not None and kept.step == options.steps
    trainer = Trainer(
        run.scene.training,
        run.depth,
        gaussians,
        options,
        plugins,
        part.seed,
        part.progress,
        _evaluation(run.scene, options),
        checkpoints,
        kept,
        part.sh_from,
        part.tells,
    )
    del gaussians  # the trainer has its own
    if ended and part.to_keep:
        trainer.resumed -= 1  # read back; what goes on is a later part
    elif kept is not None or part.again:
        trainer.resumed = max(trainer.resumed, 1)
        place = f", {part.name}" if part.name else ""
        part.progress.note(f"going on at step {trainer.step} of {options.steps}{place}")
    try:
        trained = trainer.run()
    except Diverged as error:
        state = pack(error.state, state_classes(chosen), run.identity, "diverged state")
        write_whole(run.folder / DIVERGED, state)
        error.args = (f"{error}; the state is in {run.folder.name}/{DIVERGED}",)
        raise
    if part.to_keep and not ended:
        checkpoints.keep(trainer.state())
    return trained, ended


def _evaluation(scene: Scene, options: TrainerOptions) -> Evaluate | None:
    """Mean PSNR over the test views in dB, if there are any; None where one of them has none."""
    if not scene.test:
        return None
    near = options.near_plane * scene.training.near

    def test_psnr(current: Gaussians, background: Tensor, sh_degree: int) -> float | None:
        render = renderer(current, background, sh_degree, near)
        values = [psnr(render(view.camera), view.image, view.mask) for view in scene.test]
        finite = [value for value in values if not isinstance(value, Missing)]
        return sum(finite) / len(finite) if len(finite) == len(values) else None

    return test_psnr


def renderer(
    gaussians: Gaussians, background: Tensor, sh_degree: int, near: float
) -> Callable[[Camera], Tensor]:
    """What evaluation sees: the Gaussians alone, without plugins or gradients."""

    def render(camera: Camera) -> Tensor:
        return rasterize(
            gaussians, camera, background=background, sh_degree=sh_degree, near=near, depth=False
        ).rgb

    return render
