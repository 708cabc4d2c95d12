"""Resolved configuration -> scene, depth, Gaussians, training, evaluation -> one record on disk.

Stages are timed by wall clock and CPU. A complete run with the same identity (configuration, scene,
other files, code, packages) is reused unless `force` is set. Scene and depth do not depend on the
seed or the method and are kept for the next run of the same process, which then reports their time
as it was.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from framework import registry
from framework.backends import build_rasterizer
from framework.compute import parallel, rng
from framework.compute.stopwatch import Stopwatch
from framework.depth import unspoiled
from framework.depth.exposure import ENOUGH, Exposures, find_exposures
from framework.depth.pose_check import PoseCheck
from framework.files.locks import locked, remove_stale
from framework.files.whole import following, remove_temporaries
from framework.metrics.coadaptation import with_average, with_coadaptation
from framework.metrics.evaluate import evaluate
from framework.metrics.lpips import Lpips, load
from framework.metrics.lpips_weights import chosen, fingerprint
from framework.metrics.rank import with_rank
from framework.metrics.values import COADAPTATION, Missing, ViewMetrics, measures
from framework.options import TrainerOptions
from framework.records.cameras import write_cameras
from framework.records.first_view import write_settings
from framework.records.notices import noted, warnings_of
from framework.records.photos import write_photos
from framework.records.progress import Progress
from framework.records.provenance import (
    code_hash,
    identity_of,
    peak_memory_bytes,
    provenance,
    reset_peak_memory,
)
from framework.records.record import (
    EXPOSURE,
    LPIPS,
    POSE_CHECK,
    TRAIN_STAGE,
    RunRecord,
    SceneInfo,
    StageTime,
    damaged_file,
    find_complete,
    remove_record,
    write_run,
)
from framework.records.run_files import remove_made_of_model
from framework.run import answers, budget, trackers
from framework.run.lpips_later import lacks_lpips, with_lpips
from framework.run.plugin_code import plugin_hashes
from framework.run.poses import checked_poses
from framework.run.training import Run, initial, renderer, thinned, train, try_out
from framework.run.untouched import Shared, depth_parts, foreign, scene_parts
from framework.run.warmup import Warmup
from framework.train.dose import told
from framework.train.resume.checkpoint import remove_checkpoints
from framework.train.trainer import Trained
from framework.types import DepthMap, Gaussians, Scene, View

LOG = logging.getLogger(__name__)


def run_experiment(
    config: Mapping[str, Any],
    run_dir: Path,
    progress: Progress,
    overrides: Sequence[str] = (),
) -> RunRecord:
    """Do one run, or reuse it, and leave its record in `run_dir`.

    config: plain and resolved, see `conf/config.yaml`; overrides: what the user typed. Raises
    UserError on any bad input; nothing of an older complete run is lost then. Raises `locks.Busy`
    when another process is at this run. What the framework logs meanwhile becomes notes of
    `progress`.
    """
    reset_peak_memory()
    parallel.set_threads(int(config["threads"]))
    torch.set_num_threads(1)  # kernels have their own pool; small tensors gain nothing from two
    registry.discover()
    build_rasterizer(config).ready()
    weights = chosen(config["metrics"]["lpips_weights"])
    network = None if weights is None else load(weights)  # a bad path must not cost a training
    with noted(progress), warnings_of() as warnings, Warmup(config, progress) as warmup:
        record = _experiment(config, run_dir, progress, overrides, network, warmup, warnings)
    trackers.send(config.get("tracker"), run_dir, progress)
    return record


def _experiment(
    config: Mapping[str, Any],
    run_dir: Path,
    progress: Progress,
    overrides: Sequence[str],
    network: Lpips | None,
    warmup: Warmup,
    warnings: list[str],
) -> RunRecord:
    timings: dict[str, StageTime] = {}
    progress.stage(f"scene {config['scene']['name']}")
    scene, timings["scene"], scene_warnings = _scene(_key(config["scene"]))
    plugins = plugin_hashes(config)
    files = {**_files(config, scene), **plugins}
    identity = identity_of(config, scene.fingerprint, code_hash(), files)
    done = _reusable(config, run_dir, identity)
    if done is not None and not lacks_lpips(done, network):
        progress.done(_reused(done))
        remove_stale(run_dir, remove_checkpoints)  # of one killed just after it wrote the record
        return done
    with locked(run_dir):
        # whoever held the lock before us may have done it
        done = _reusable(config, run_dir, identity)
        if done is not None:
            remove_checkpoints(run_dir)
            done = with_lpips(run_dir, done, network)
            progress.done(_reused(done))
            return done
        damage = "" if config["force"] else damaged_file(run_dir, identity)
        if damage:
            LOG.warning(f"{run_dir.name}: {damage}; running it again")
        remove_temporaries(run_dir)
        shared = Shared(foreign(config))
        shared.watch(scene_parts(scene))
        with _read_anew_if_changed(shared):
            warmup.begin()
            progress.stage(f"depth {config['depth']['name']}")
            keys = _key(config["scene"]), _key(config["depth"])
            depth, timings["depth"], depth_warnings = _depth(*keys, files["depth"])
            shared.watch(depth_parts(scene, depth))
            check, timings["pose_check"], pose_warnings = _pose_check(keys[0])
            warnings += scene_warnings + depth_warnings + pose_warnings
            warmup.finish()
            record = RunRecord(
                identity=identity,
                config=dict(config),
                overrides=tuple(overrides),
                scene=_info(scene),
                timings=timings,
                provenance={
                    **provenance(),
                    "plugins": plugins,
                    **build_rasterizer(config).facts(),
                    "threads": parallel.threads(),
                    LPIPS: None if network is None else network.name,
                    POSE_CHECK: None if check is None else check.figures(),
                },
            )
            exposures = None
            # stereo from wrong poses says nothing about exposure
            fits = check is None or check.fits
            if TrainerOptions(**config["trainer"]).exposure and fits:
                gains, timings["exposure"] = _log_gains(*keys, files["depth"])
                if gains is not None:
                    cameras = tuple(view.camera for view in scene.training.views)
                    exposures = Exposures(cameras, gains)
            made = (timings, run_dir, scene, depth, exposures, network, progress)
            record = _trained(record, *made, shared, warnings)
    progress.done(_result(record))
    return record


@contextmanager
def _read_anew_if_changed(shared: Shared) -> Iterator[None]:
    """Where this run changed what runs share, however it ends, the next one reads it anew."""
    try:
        yield
    finally:
        if shared.changed():
            for kept in (_scene, _depth, _pose_check, _log_gains):
                kept.cache_clear()


def _reusable(config: Mapping[str, Any], run_dir: Path, identity: str) -> RunRecord | None:
    """The complete record of the same run, unless it is to be repeated."""
    return None if config["force"] else find_complete(run_dir, identity)


def _trained(
    record: RunRecord,
    timings: dict[str, StageTime],
    run_dir: Path,
    scene: Scene,
    depth: tuple[DepthMap, ...],
    exposures: Exposures | None,
    network: Lpips | None,
    progress: Progress,
    shared: Shared,
    warnings: list[str],
) -> RunRecord:
    """The record with the result of its run, as written; `timings` are those it holds."""
    config = record.config
    rasterizer = build_rasterizer(config)
    photos, told_of_scene = scene.training.views, {}
    if exposures is not None:
        progress.note(exposures.told())
        told_of_scene = {EXPOSURE: exposures.size}
        evened = dataclasses.replace(scene.training, views=exposures.evened(photos))
        scene = dataclasses.replace(scene, training=evened)

    def start(seed: int) -> Gaussians:
        with _timed(timings, "init"):
            return initial(config, scene, depth, TrainerOptions(**config["trainer"]), seed)

    identity, force = record.identity, config["force"]
    run = Run(scene, depth, start, run_dir, identity, force, rasterizer, exposures)
    options, told_of_budget = _steps_for_its_seconds(run, config, progress)
    config = {**config, "trainer": dataclasses.asdict(options)}
    trained = train(run, config, progress)
    timings[TRAIN_STAGE] = StageTime(trained.wall_s, trained.cpu_s)
    progress.stage("evaluation")
    near = options.near_plane * scene.training.near
    with _timed(timings, "evaluate"):
        measured = _measured(config, trained, near, scene.test, network, run)
    shared.check()
    record = dataclasses.replace(
        record,
        provenance={**record.provenance, **told_of_budget, **told_of_scene},
        peak_memory_bytes=peak_memory_bytes(),
        resumed=trained.resumed,
        dose=told(trained.dose),
        warnings=tuple(dict.fromkeys(warnings)),
    )
    return _written(record, run, photos, near, trained, *measured)


def _written(
    record: RunRecord,
    run: Run,
    photos: tuple[View, ...],
    near: float,
    trained: Trained,
    metrics: list[ViewMetrics],
    renders: list[tuple[View, Tensor]],
) -> RunRecord:
    """The run's files; the record last, as it says that all others are there. photos: the training
    views as they were taken, whatever the exposures of those of `run` were evened by."""
    run_dir, test = run.folder, run.scene.test
    stale = remove_record(run_dir)  # of a run before, with other files than these
    with following(run_dir) as before:
        factors = None if run.exposures is None else run.exposures.factors
        write_cameras(run_dir, photos, test, near, factors)
        means, background = trained.gaussians.means, trained.background
        write_settings(run_dir, photos, means, background, near)
        write_photos(run_dir, photos)
    record = write_run(
        run_dir,
        record,
        metrics,
        trained.history,
        trained.gaussians,
        trained.background,
        renders,
        before,
        stale,
    )
    remove_checkpoints(run_dir)
    (run_dir / budget.FILE).unlink(missing_ok=True)
    remove_made_of_model(run_dir)
    return record


def _steps_for_its_seconds(
    run: Run, config: Mapping[str, Any], progress: Progress
) -> tuple[TrainerOptions, dict[str, Any]]:
    """The trainer's options, with steps chosen if they were given as seconds, and what is told."""
    options = TrainerOptions(**config["trainer"])
    if options.seconds <= 0:
        return options, {}
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
    progress.note(f"{choice.told['seconds']:g} s of training: {choice.told['repeat']}")
    return choice.applied(options), {"budget": choice.told}


def _measured(
    config: Mapping[str, Any],
    trained: Trained,
    near: float,
    test: Sequence[View],
    network: Lpips | None,
    run: Run,
) -> tuple[list[ViewMetrics], list[tuple[View, Tensor]]]:
    """What the test views say of a trained model, and its renders of them."""
    seen = trained.gaussians, trained.background, trained.sh_degree
    render = renderer(*seen, near, run.rasterizer, run.exposures)
    names = measures(config["metrics"].get("also"))
    also = {name: registry.part("metric", {"name": name}) for name in names}
    metrics, renders = evaluate(render, test, network, also)
    metrics = with_average(metrics)
    if config["metrics"].get(COADAPTATION):
        half = thinned(*seen, near, run.rasterizer)
        cameras = [view.camera for view in test]
        draws = rng.stream(config["seed"], COADAPTATION)
        metrics = with_coadaptation(metrics, half, len(trained.gaussians), cameras, draws)
        metrics = with_rank(metrics, trained.gaussians.log_scales)
    return metrics, renders


def _key(options: Mapping[str, Any]) -> str:
    """Options as a hashable text."""
    return json.dumps(dict(options), sort_keys=True)


@functools.lru_cache(maxsize=2)
def _scene(key: str) -> tuple[Scene, StageTime, list[str]]:
    timings: dict[str, StageTime] = {}
    with _timed(timings, "scene"), warnings_of() as warnings:
        options = json.loads(key)
        loader = registry.part("scene", options)
        with answers.called(f"scene={options['name']}: load", type(loader)):
            found = loader.load()
        scene = answers.scene(options["name"], type(loader), found)
    return scene, timings["scene"], warnings


def _files(config: Mapping[str, Any], scene: Scene) -> dict[str, str]:
    """Purpose -> fingerprint of the files beside the scene's that the run reads; "" for none."""
    provider = registry.part("depth", config["depth"])
    with answers.called(f"depth={config['depth']['name']}: fingerprint", type(provider)):
        depth = provider.fingerprint(scene.training)
    return {
        "depth": depth,
        "lpips_weights": fingerprint(config["metrics"]["lpips_weights"]),
    }


@functools.lru_cache(maxsize=2)
def _depth(
    scene_key: str, key: str, fingerprint: str
) -> tuple[tuple[DepthMap, ...], StageTime, list[str]]:
    """The depth maps; `fingerprint` tells files that were replaced since they were last read."""
    timings: dict[str, StageTime] = {}
    with _timed(timings, "depth"), warnings_of() as warnings:
        options = json.loads(key)
        training, provider = _scene(scene_key)[0].training, registry.part("depth", options)
        with answers.called(f"depth={options['name']}: measure", type(provider)):
            maps = provider.estimate(training)
        depth = answers.depth(options["name"], type(provider), maps, training)
    return depth, timings["depth"], warnings


@functools.lru_cache(maxsize=2)
def _pose_check(scene_key: str) -> tuple[PoseCheck | None, StageTime, list[str]]:
    """Whether stereo confirms the poses; None where they are known or cannot be checked."""
    timings: dict[str, StageTime] = {}
    options = json.loads(scene_key)
    with _timed(timings, "pose_check"), warnings_of() as warnings:
        loader, training = registry.part("scene", options), _scene(scene_key)[0].training
        check = checked_poses(options["name"], loader, training)
    return check, timings["pose_check"], warnings


@functools.lru_cache(maxsize=2)
def _log_gains(
    scene_key: str, depth_key: str, fingerprint: str
) -> tuple[NDArray[np.float64] | None, StageTime]:
    """Of the photos' exposures, None where they are alike; by `_depth` of the same arguments, but
    as it was before a stress study spoiled it."""
    views = _scene(scene_key)[0].training.views
    timings = {"exposure": StageTime(0.0, 0.0)}
    if len(views) < ENOUGH:
        return None, timings["exposure"]
    clean = _key(unspoiled(json.loads(depth_key)))
    depth = _depth(scene_key, clean, fingerprint)[0]
    with _timed(timings, "exposure"):
        found = find_exposures(views, depth)
    return None if found is None else found.log_gains, timings["exposure"]


def _info(scene: Scene) -> SceneInfo:
    return SceneInfo(
        scene.name,
        scene.protocol,
        scene.fingerprint,
        tuple(view.name for view in scene.training.views),
        tuple(view.name for view in scene.test),
    )


def _result(record: RunRecord) -> str:
    """One line about a finished run."""
    train_s = record.train_s
    seconds = "" if train_s is None else f" · {train_s:.1f} s of training"
    return f"{_quality(record)} · {record.gaussians} Gaussians{seconds}"


def _quality(record: RunRecord) -> str:
    psnr_db = record.summary.get("psnr")
    if record.scene is not None and not record.scene.test:
        return f"not tested (scene.split={record.scene.protocol})"
    if psnr_db is None or isinstance(psnr_db, Missing):
        return "no test PSNR"
    return f"test {psnr_db:.2f} dB"


def _reused(record: RunRecord) -> str:
    return f"{_result(record)} · reused, already complete (force=true repeats it)"


@contextmanager
def _timed(timings: dict[str, StageTime], stage: str) -> Iterator[None]:
    """The time goes to that of the stage so far."""
    before, watch = timings.get(stage, StageTime(0.0, 0.0)), Stopwatch()
    yield
    timings[stage] = StageTime(before.wall_s + watch.wall_s, before.cpu_s + watch.cpu_s)
