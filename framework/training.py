"""One run's training: from the scene and its depth to the trained Gaussians, kept on the way.

A training that was interrupted goes on from its last checkpoint and ends with the same bits; one
that diverged leaves its state in `diverged.safetensors`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from framework import registry
from framework.checkpoint import Checkpoints, pack, remove_checkpoints, state_classes
from framework.files import write_whole
from framework.guard import Diverged
from framework.initialize import INITIALIZERS
from framework.metrics import Missing, psnr
from framework.options import TrainerOptions
from framework.plugin import Plugin
from framework.progress import Progress
from framework.rasterize import rasterize
from framework.record import DIVERGED
from framework.state_check import check_state
from framework.trainer import Evaluate, Plugins, Trained, Trainer
from framework.types import Camera, DepthMap, Gaussians, Scene

BYTES_PER_FLOAT, COPIES = 4, 3  # of every parameter: itself and two moments


def initial(
    config: Mapping[str, Any], scene: Scene, depth: tuple[DepthMap, ...], options: TrainerOptions
) -> Gaussians:
    """The Gaussians that the chosen initializer starts from."""
    rest = dict(config["init"])
    builder = INITIALIZERS[rest.pop("name")](**rest)
    gaussians: Gaussians = builder.build(
        scene.training, depth, options.sh_degree, int(config["seed"])
    )
    return gaussians


def train(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    start: Callable[[], Gaussians],
    options: TrainerOptions,
    run_dir: Path,
    identity: str,
    progress: Progress,
) -> Trained:
    """Train, or go on with what an interrupted process left in `run_dir` under this identity.

    start: makes the Gaussians to begin with, which nobody else keeps then. `force` begins anew.
    Raises Diverged when the training diverges; the state is in the run's folder then.
    """
    gaussians = start()
    plugins = Plugins(*(registry.build(group, config[group]) for group in registry.GROUPS))
    chosen: list[Plugin] = [p.plugin for p in (plugins.augment, plugins.reg, plugins.capacity)]
    size = COPIES * BYTES_PER_FLOAT * sum(tensor.numel() for _, tensor in gaussians.items())
    checkpoints = Checkpoints(run_dir, identity, chosen, size)
    if config["force"]:
        remove_checkpoints(run_dir)
    by_group = dict(zip(registry.GROUPS, chosen, strict=True))
    check = functools.partial(
        check_state, training=scene.training, options=options, plugins=by_group
    )
    kept = checkpoints.newest(check)
    if kept is not None:
        progress.note(f"going on at step {kept.step} of {options.steps}")
    trainer = Trainer(
        scene.training,
        depth,
        gaussians,
        options,
        plugins,
        int(config["seed"]),
        progress,
        _evaluation(scene, options),
        checkpoints,
        kept,
    )
    del gaussians  # the trainer has its own
    try:
        return trainer.run()
    except Diverged as error:
        state = pack(error.state, state_classes(chosen), identity, "diverged state")
        write_whole(run_dir / DIVERGED, state)
        error.args = (f"{error}; the state is in {run_dir.name}/{DIVERGED}",)
        raise


def _evaluation(scene: Scene, options: TrainerOptions) -> Evaluate:
    """Mean PSNR over the test views in dB; None where one of them has none."""
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
