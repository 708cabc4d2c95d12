"""The stages before a training: load the scene, estimate depth, check poses, compare exposures.

They depend neither on the seed nor on the method. Each stage keeps its last two results for the
next run of the process, which then reports the time of the first.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Generic, TypeVar

from framework import registry
from framework.compute.stopwatch import Stopwatch
from framework.depth import unspoiled
from framework.depth.exposure import ENOUGH, Exposures, find_exposures
from framework.depth.pose_check import PoseCheck
from framework.options import TrainerOptions
from framework.records.notices import warnings_of
from framework.records.progress import Progress
from framework.records.record import StageTime
from framework.run import answers
from framework.run.plugin_code import chosen_plugins
from framework.run.poses import checked_poses
from framework.run.warmup import Warmup
from framework.scenes import ALL, UNTESTED
from framework.types import DepthMap, Scene, TrainingSet

LOG = logging.getLogger(__name__)
FEW_PHOTOS = 5

Options = tuple[tuple[str, Any], ...]  # the options of a part of the configuration, hashable
T = TypeVar("T")


@dataclass(frozen=True)
class Preparation:
    """What a training starts from.

    Attributes:
        depth: one map per training view.
        pose_check: None where poses are exact or cannot be checked.
        exposures: None where photos are exposed alike.
        warnings: also of cached stages.
    """

    scene: Scene
    depth: tuple[DepthMap, ...]
    pose_check: PoseCheck | None
    exposures: Exposures | None
    timings: dict[str, StageTime]
    warnings: list[str]


@dataclass(frozen=True)
class Stage(Generic[T]):
    """The result of a stage, the time that it took and the warnings that it logged."""

    result: T
    time: StageTime
    warnings: tuple[str, ...]


def _stage(function: Callable[..., T]) -> Callable[..., Stage[T]]:
    """Time a stage, collect its warnings and keep its last two results."""

    @functools.lru_cache(maxsize=2)
    @functools.wraps(function)
    def timed(*args: Any) -> Stage[T]:
        watch = Stopwatch()
        with warnings_of() as warnings:
            result = function(*args)
        return Stage(result, StageTime(watch.wall_s, watch.cpu_s), tuple(warnings))

    return timed


def evened(scene: Scene, exposures: Exposures | None) -> Scene:
    """The scene with the exposures of its training photos evened, if they are given."""
    if exposures is None:
        return scene
    views = exposures.evened(scene.training.views)
    return replace(scene, training=replace(scene.training, views=views))


def options_of(config: Mapping[str, Any], group: str) -> Options:
    """The options of a configuration group as the key of a stage."""
    return tuple(config[group].items())


def loaded_scene(chosen: Mapping[str, Any]) -> Scene:
    """Load the scene that these options of `scene` choose."""
    loader = registry.part("scene", chosen)
    where = f"scene={chosen['name']}: load"
    scene: Scene = answers.ask(where, loader, loader.load, answers.check_scene)
    if chosen.get("n_views") == ALL:
        for line in _split_lines(scene):
            LOG.info(line)
    return scene


def estimated_depth(chosen: Mapping[str, Any], training: TrainingSet) -> tuple[DepthMap, ...]:
    """Estimate the depth of the training views by these options of `depth`."""
    provider = registry.part("depth", chosen)
    return answers.ask(
        f"depth={chosen['name']}: measure",
        provider,
        partial(provider.estimate, training),
        partial(answers.check_depth, training=training),
    )


@_stage
def load_scene(options: Options) -> Scene:
    """Load the scene that the options of `scene` choose."""
    return loaded_scene(dict(options))


@_stage
def estimate_depth(scene: Options, depth: Options, fingerprint: str) -> tuple[DepthMap, ...]:
    """Depth of the training views; `fingerprint` is that of the files which the provider reads."""
    return estimated_depth(dict(depth), load_scene(scene).result.training)


@_stage
def check_poses(scene: Options) -> PoseCheck | None:
    """Compare the poses with stereo; None where they are exact or cannot be checked."""
    chosen = dict(scene)
    loader, training = registry.part("scene", chosen), load_scene(scene).result.training
    return checked_poses(chosen["name"], loader, training)


@_stage
def compare_exposures(scene: Options, depth: Options, fingerprint: str) -> Exposures | None:
    """Estimate the exposures of the training photos; None where they are alike.

    The depth is the one before a stress study corrupts it.
    """
    views = load_scene(scene).result.training.views
    if len(views) < ENOUGH:
        return None
    return find_exposures(views, estimate_depth(scene, _uncorrupted(depth), fingerprint).result)


def prepare(
    config: Mapping[str, Any],
    depth_fingerprint: str,
    warmup: Warmup,
    progress: Progress,
) -> Preparation:
    """Do all stages before the training.

    Args:
        config: of the run, plain and resolved.
        depth_fingerprint: of the files that the depth provider reads.
        warmup: loads kernels while the stages run; complete on return.
        progress: shows the stages.
    """
    scene_options, depth_options = options_of(config, "scene"), options_of(config, "depth")
    scene = load_scene(scene_options)
    warmup.begin()
    progress.stage(f"depth {config['depth']['name']}")
    depth = estimate_depth(scene_options, depth_options, depth_fingerprint)
    poses = check_poses(scene_options)
    warmup.finish()
    stages: dict[str, Stage[Any]] = {"scene": scene, "depth": depth, "pose_check": poses}
    exposures = None
    # wrong poses say nothing about exposure
    if TrainerOptions(**config["trainer"]).exposure and (poses.result is None or poses.result.fits):
        if len(scene.result.training.views) >= ENOUGH:  # its time is not that of the next stage
            estimate_depth(scene_options, _uncorrupted(depth_options), depth_fingerprint)
        stages["exposure"] = compare_exposures(scene_options, depth_options, depth_fingerprint)
        exposures = stages["exposure"].result
    if exposures is not None:  # cameras of the scene as it is loaded now
        cameras = tuple(view.camera for view in scene.result.training.views)
        exposures = replace(exposures, cameras=cameras)
    return Preparation(
        scene.result,
        depth.result,
        poses.result,
        exposures,
        {name: stage.time for name, stage in stages.items()},
        [line for stage in stages.values() for line in stage.warnings],
    )


@contextmanager
def forgotten_if_foreign(config: Mapping[str, Any]) -> Iterator[None]:
    """Drop the kept results after a run with plugins that are not this project's: they may have
    written into what runs share."""
    modules = [cls.__module__.partition(".")[0] for cls in chosen_plugins(config).values()]
    try:
        yield
    finally:
        if not set(modules) <= set(registry.OURS):
            forget()


def forget() -> None:
    """Drop the kept results of all stages."""
    for stage in (load_scene, estimate_depth, check_poses, compare_exposures):
        stage.cache_clear()  # type: ignore[union-attr]


def _uncorrupted(depth: Options) -> Options:
    """The options of the same depth provider without its corruption."""
    return tuple(unspoiled(dict(depth)).items())


def _split_lines(scene: Scene) -> list[str]:
    """How many of the user's photos train and test, and what so few of them can do."""
    train, test = len(scene.training.views), len(scene.test)
    lines = []
    if test:
        names = ", ".join(view.name for view in scene.test[:3]) + (", ..." if test > 3 else "")
        lines.append(
            f"{train + test} photos: {train} for training, {test} for testing ({names});"
            f" scene.split={UNTESTED} trains on all of them and tests nothing"
        )
    if train + test <= FEW_PHOTOS:
        lines.append(
            f"with {train + test} photos expect good views between the cameras, but not of what no"
            " photo shows, such as the back of an object"
        )
    return lines
