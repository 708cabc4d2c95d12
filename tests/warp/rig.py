"""The embedded scene for warping: exact depth of its training views, its truth at any camera."""

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from framework.compute.parallel import run_blocks
from framework.compute.rng import stream
from framework.fisher.information import FisherInformation, fisher_information
from framework.geometry import mean_neighbour_distance
from framework.initialize import Stereo
from framework.plugin import StepContext
from framework.scenes import Embedded
from framework.scenes.embedded.build import build_world, camera_tiles
from framework.scenes.embedded.trace import trace_rows
from framework.types import Camera, DepthMap, Gaussians, Render, Scene, View
from framework.warp.zbuffer import prepare
from tests.built import load_scene

SAMPLES = Embedded().supersampling


@lru_cache
def embedded() -> tuple[Scene, tuple[DepthMap, ...], Gaussians]:
    """The scene, the exact depth of its training views, and 5,000 Gaussians on its surfaces."""
    scene = load_scene("embedded", {})
    depth = tuple(exact(view) for view in scene.training.views)
    return scene, depth, Stereo(budget=5000, opacity=0.8).build(scene.training, depth, 0, 0)


def exact(view: View) -> DepthMap:
    """The exact depth of a view, fully trusted."""
    assert view.depth is not None
    return DepthMap(view.depth, (view.depth > 0).float())


def truth(camera: Camera) -> torch.Tensor:
    """[3, H, W]: what ray tracing shows at `camera`."""
    width, height, focal = camera.width, camera.height, float(camera.K[0, 0])
    pose = np.column_stack([camera.viewmat[:3, :3].numpy().T, camera.center.numpy()])
    image = np.zeros((height, width, 3), np.uint8)
    depth = np.zeros((height, width), np.float32)
    world, tiles = _world(), camera_tiles(pose, focal, width, height)
    run_blocks(trace_rows, *world, tiles.members, tiles.size, pose, focal, SAMPLES, image, depth)
    return torch.from_numpy(image).permute(2, 0, 1).float() / 255


@lru_cache
def _world():  # type: ignore[no-untyped-def]
    return build_world(1.0, 1.0, SAMPLES)


def context(epoch: int, log: Callable[[str, float], None]) -> StepContext:
    """What an augmenter sees in `epoch` of a training on the scene."""
    scene, depth, gaussians = embedded()
    training = scene.training
    views = training.views
    near = 0.05 * training.near

    def render(_: Camera) -> Render:
        raise AssertionError("the plugin is not expected to render")

    def fisher(
        camera: Camera,
        others: Gaussians | None = None,
        sh_degree: int | None = None,
        mask: Tensor | None = None,
    ) -> FisherInformation:
        chosen = gaussians if others is None else others
        return fisher_information(chosen, camera, sh_degree=sh_degree, near=near, mask=mask)

    return StepContext(
        step=3 * epoch,
        n_steps=600,
        epoch=epoch,
        views=views,
        depth=depth,
        gaussians=gaussians,
        version=0,
        sh_degree=0,
        background=torch.zeros(3),
        extent=training.extent,
        spacing=mean_neighbour_distance([view.camera for view in training.views]),
        near=training.near,
        far=training.far,
        supports=lambda: prepare(views, depth),
        render=render,
        fisher=fisher,
        rng=lambda purpose: stream(0, f"augment/{purpose}", 3 * epoch),
        log=log,
    )
