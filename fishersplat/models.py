"""Train on a scene in memory, and render."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from fishersplat.configuration import configuration
from fishersplat.runs import Run

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, DepthMap, Gaussians, Render, Scene


@dataclass(frozen=True)
class Model:
    """Trained Gaussians with what is needed to render them.

    Attributes:
        gaussians: `means` [N, 3], `quats` [N, 4], `log_scales` [N, 3], ...
        background: [3], in [0, 1].
        near: depth in scene units, before which nothing is drawn.
        history: one row per logged step, as `Run.history`.
    """

    gaussians: Gaussians
    background: Tensor
    near: float
    history: pd.DataFrame


def train(
    scene: Scene, *options: str, depth: Sequence[DepthMap] | None = None, quiet: bool = True
) -> Model:
    """Train on a scene without writing files.

    Args:
        scene: from `load_scene`, or built with `framework.scenes.assemble`.
        options: words of the command line except `scene`, for instance `"augment=safi"`.
        depth: depth maps of the training views; by default the `depth` option estimates them.
        quiet: print no progress.

    Returns:
        The trained model. The same arguments give the same bits.

    Raises:
        UserError: An option is invalid, or the scene cannot be trained on.
    """
    config = configuration(options).values
    import torch

    from framework import registry
    from framework.backends import build_rasterizer
    from framework.compute import parallel
    from framework.depth.exposure import ENOUGH, find_exposures
    from framework.options import TrainerOptions
    from framework.records.progress import Silent, Terminal
    from framework.run import training

    parallel.set_threads(int(config["threads"]))
    torch.set_num_threads(1)
    trainer = TrainerOptions(**config["trainer"])
    maps = tuple(depth or registry.part("depth", config["depth"]).estimate(scene.training))
    views, exposures = scene.training.views, None
    if trainer.exposure and len(views) >= ENOUGH:
        exposures = find_exposures(views, maps)
    if exposures is not None:
        evened = replace(scene.training, views=exposures.evened(views))
        scene = replace(scene, training=evened)

    def start(seed: int) -> Gaussians:
        return training.initial(config, scene, maps, trainer, seed)

    with tempfile.TemporaryDirectory(prefix="fishersplat-") as folder:
        job = training.Run(
            scene, maps, start, Path(folder), "", True, build_rasterizer(config), exposures
        )
        trained = training.train(job, config, Silent() if quiet else Terminal("train"))
    near = trainer.near_plane * scene.training.near
    return Model(trained.gaussians, trained.background, near, _frame(trained.history))


def render(model: Run | Model, camera: Camera) -> Render:
    """Render a trained model.

    Args:
        model: a `Run` or a `Model`.
        camera: of a view (`scene.test[0].camera`, `run.cameras[name]`) or your own.

    Returns:
        `rgb` [3, H, W] in [0, 1], `alpha` [H, W], and `expected_depth` [H, W] in scene units.
    """
    if isinstance(model, Run):
        return model._opened.render(camera, depth=True)
    from framework.kernels import rasterize

    return rasterize(
        model.gaussians, camera, background=model.background, near=model.near, depth=True
    )


def _frame(history: Sequence[Any]) -> pd.DataFrame:
    columns = ("step", "seconds", "loss", "test_psnr", "gaussians", "sh_degree")
    rows = [{name: getattr(row, name) for name in columns} for row in history]
    return pd.DataFrame(rows, columns=list(columns))
