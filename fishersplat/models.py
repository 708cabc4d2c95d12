"""Load a scene, train on it in memory, and render."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from fishersplat.arguments import composed, expect
from fishersplat.runs import Run
from framework.errors import UserError, require

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import Camera, DepthMap, Gaussians, Render, Scene

# options of a run that a training in memory does not have
UNUSED = ("scene", "metrics", "tracker", "study", "force", "estimate")


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


def load_scene(name: str, **options: Any) -> Scene:
    """Load a scene.

    Camera poses that do not fit the photos cause a logged warning, as in a run.

    Args:
        name: a loader, for instance `embedded`, `colmap`, `llff` or `photos`.
        options: options of the loader, for instance `path="DIR"` and `n_views=3`.

    Returns:
        The scene: `training.views` and `test` are tuples of views with `image` [3, H, W] in [0, 1]
        and `camera`. Training functions receive `training` only.

    Raises:
        UserError: The loader or an option is unknown, or the files are invalid.
    """
    from framework import registry
    from framework.run.poses import checked_poses
    from framework.run.preparation import loaded_scene

    registry.discover()
    plain = {k: os.fspath(v) if isinstance(v, os.PathLike) else v for k, v in options.items()}
    chosen = {"name": name, **plain}
    scene = loaded_scene(chosen)
    checked_poses(name, registry.part("scene", chosen), scene.training)
    return scene


def train(
    scene: Scene, *options: str, depth: Sequence[DepthMap] | None = None, quiet: bool = True
) -> Model:
    """Train on a scene without writing files.

    Args:
        scene: from `load_scene`, or built with `framework.scenes.assemble`.
        options: words of the command line that concern the training, for instance
            `"augment=safi"`. Options of the scene or of the evaluation are errors.
        depth: depth maps of the training views; by default the `depth` option estimates them.
        quiet: print no progress.

    Returns:
        The trained model. The same arguments give the same bits.

    Raises:
        UserError: An option is invalid or would have no effect, or the scene cannot be trained on.
    """
    without_effect = UNUSED if depth is None else (*UNUSED, "depth")
    for word in options:
        key = str(word).lstrip("+~").partition("=")[0].partition(".")[0]
        require(
            key not in without_effect,
            f"train: {word}: expected an option of the training, got one without effect here; use"
            " load_scene for the scene, or run(...) to evaluate and write a run",
        )
    config = composed("train", options).values
    import torch

    from framework.backends import build_rasterizer
    from framework.compute import parallel
    from framework.depth.exposure import find_exposures
    from framework.options import TrainerOptions
    from framework.records.progress import Silent, Terminal
    from framework.run import answers, preparation, training

    parallel.set_threads(int(config["threads"]))
    torch.set_num_threads(1)
    rasterizer, trainer = build_rasterizer(config), TrainerOptions(**config["trainer"])
    rasterizer.ready()
    try:
        answers.check_scene(scene)
        if depth is not None:
            answers.check_depth(tuple(depth), scene.training)
    except ValueError as error:
        raise UserError(f"train: {error}") from None
    if depth is None:
        maps, clear = _estimated(scene, config["depth"], trainer.exposure)
    else:
        maps = clear = tuple(depth)
    exposures = find_exposures(scene.training.views, clear) if trainer.exposure else None
    evened = preparation.evened(scene, exposures)

    def start(seed: int) -> Gaussians:
        return training.initial(config, evened, maps, trainer, seed)

    progress = Silent() if quiet else Terminal("train")
    with tempfile.TemporaryDirectory(prefix="fishersplat-") as folder:
        job = training.Run(evened, maps, start, Path(folder), "", True, rasterizer, exposures)
        trained = training.train(job, training.within_seconds(job, config, progress)[0], progress)
    return Model(trained.gaussians, trained.background, job.near(trainer), _frame(trained.history))


def _estimated(
    scene: Scene, chosen: dict[str, Any], exposure: bool
) -> tuple[tuple[DepthMap, ...], tuple[DepthMap, ...]]:
    """The depth of the training views by the options of `depth`, and the depth for exposures, which
    a stress study does not corrupt."""
    from framework import registry
    from framework.depth import unspoiled
    from framework.run.preparation import estimated_depth

    registry.part("depth", chosen).ready()
    maps, clean = estimated_depth(chosen, scene.training), unspoiled(chosen)
    corrupted = exposure and clean != chosen
    return maps, estimated_depth(clean, scene.training) if corrupted else maps


def render(model: Run | Model, camera: Camera) -> Render:
    """Render a trained model.

    Args:
        model: a `Run` or a `Model`.
        camera: of a view (`scene.test[0].camera`, `run.cameras[name]`) or your own.

    Returns:
        `rgb` [3, H, W] in [0, 1], `alpha` [H, W], and `expected_depth` [H, W] in scene units.

    Raises:
        UserError: The model or the camera is something else, such as a folder or a name.
    """
    from framework.types import Camera

    known = isinstance(model, Run | Model)
    expect(known, "render", "a Run or a Model", model, "use load_run(FOLDER) or train(...)")
    advice = "use run.cameras[NAME] or view.camera"
    expect(isinstance(camera, Camera), "render", "a camera", camera, advice)
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
