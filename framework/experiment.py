"""Resolved configuration -> scene, depth, Gaussians, training, evaluation -> one record on disk.

Stages are timed by wall clock and CPU. A complete run with the same identity (configuration, scene,
other files, code, packages) is reused unless `force` is set. Scene and depth do not depend on the
seed or the method and are kept for the next run of the same process, which then reports their time
as it was.
"""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from framework import parallel, registry
from framework.depth import build_provider
from framework.initialize import INITIALIZERS
from framework.lpips import Lpips, load
from framework.metrics import Missing, evaluate, psnr
from framework.notices import noted
from framework.options import TrainerOptions
from framework.progress import Progress
from framework.provenance import (
    code_hash,
    file_sha256,
    identity_of,
    peak_memory_bytes,
    provenance,
    reset_peak_memory,
)
from framework.rasterize import rasterize
from framework.record import (
    TRAIN_STAGE,
    RunRecord,
    SceneInfo,
    StageTime,
    find_complete,
    write_run,
)
from framework.scenes import load_scene
from framework.trainer import Plugins, Trained, Trainer
from framework.types import Camera, DepthMap, Gaussians, Scene
from framework.warmup import Warmup


def run_experiment(
    config: Mapping[str, Any],
    run_dir: Path,
    progress: Progress,
    overrides: Sequence[str] = (),
) -> RunRecord:
    """Do one run, or reuse it, and leave its record in `run_dir`.

    config: plain and resolved, see `conf/config.yaml`; overrides: what the user typed. Raises
    UserError on any bad input; nothing of an older complete run is lost then. What the framework
    logs meanwhile becomes notes of `progress`.
    """
    reset_peak_memory()
    parallel.set_threads(int(config["threads"]))
    torch.set_num_threads(1)  # kernels have their own pool; small tensors gain nothing from two
    registry.discover()
    weights = config["metrics"]["lpips_weights"]
    network = None if weights is None else load(weights)  # a bad path must not cost a training
    with noted(progress), Warmup(config, progress) as warmup:
        return _experiment(config, run_dir, progress, overrides, network, warmup)


def _experiment(
    config: Mapping[str, Any],
    run_dir: Path,
    progress: Progress,
    overrides: Sequence[str],
    network: Lpips | None,
    warmup: Warmup,
) -> RunRecord:
    timings: dict[str, StageTime] = {}
    progress.stage(f"scene {config['scene']['name']}")
    scene, timings["scene"] = _scene(_key(config["scene"]))
    files = _files(config, scene)
    identity = identity_of(config, scene.fingerprint, code_hash(), files)
    done = find_complete(run_dir, identity)
    if done is not None and not config["force"]:
        progress.done(f"{_result(done)} · reused, already complete (force=true repeats it)")
        return done
    warmup.finish()
    progress.stage(f"depth {config['depth']['name']}")
    depth, timings["depth"] = _depth(_key(config["scene"]), _key(config["depth"]), files["depth"])
    options = TrainerOptions(**config["trainer"])
    with _timed(timings, "init"):
        gaussians = _initial(config, scene, depth, options)
    trained, timings[TRAIN_STAGE] = _train(config, scene, depth, gaussians, options, progress)
    progress.stage("evaluation")
    with _timed(timings, "evaluate"):
        near = options.near_plane * scene.training.near
        render = _renderer(trained.gaussians, trained.background, trained.sh_degree, near)
        metrics, renders = evaluate(render, scene.test, network)
    record = RunRecord(
        identity=identity,
        config=dict(config),
        overrides=tuple(overrides),
        scene=_info(scene),
        timings=timings,
        provenance={**provenance(), "threads": parallel.threads()},
        peak_memory_bytes=peak_memory_bytes(),
    )
    record = write_run(
        run_dir,
        record,
        metrics,
        trained.history,
        trained.gaussians,
        trained.background,
        renders,
    )
    progress.done(_result(record))
    return record


def _key(options: Mapping[str, Any]) -> str:
    """Options as a hashable text."""
    return json.dumps(dict(options), sort_keys=True)


def _options(key: str) -> tuple[str, dict[str, Any]]:
    options = json.loads(key)
    return options.pop("name"), options


@functools.lru_cache(maxsize=2)
def _scene(key: str) -> tuple[Scene, StageTime]:
    timings: dict[str, StageTime] = {}
    with _timed(timings, "scene"):
        scene = load_scene(*_options(key))
    return scene, timings["scene"]


def _files(config: Mapping[str, Any], scene: Scene) -> dict[str, str]:
    """Purpose -> fingerprint of the files beside the scene's that the run reads; "" for none."""
    weights = config["metrics"]["lpips_weights"]
    provider = build_provider(*_options(_key(config["depth"])))
    return {
        "depth": provider.fingerprint(scene.training),
        "lpips_weights": "" if weights is None else file_sha256(Path(weights)),
    }


@functools.lru_cache(maxsize=2)
def _depth(scene_key: str, key: str, fingerprint: str) -> tuple[tuple[DepthMap, ...], StageTime]:
    """The depth maps; `fingerprint` tells files that were replaced since they were last read."""
    timings: dict[str, StageTime] = {}
    with _timed(timings, "depth"):
        depth = build_provider(*_options(key)).estimate(_scene(scene_key)[0].training)
    return depth, timings["depth"]


def _initial(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    options: TrainerOptions,
) -> Gaussians:
    name, rest = _options(_key(config["init"]))
    builder = INITIALIZERS[name](**rest)
    gaussians: Gaussians = builder.build(
        scene.training, depth, options.sh_degree, int(config["seed"])
    )
    return gaussians


def _train(
    config: Mapping[str, Any],
    scene: Scene,
    depth: tuple[DepthMap, ...],
    gaussians: Gaussians,
    options: TrainerOptions,
    progress: Progress,
) -> tuple[Trained, StageTime]:
    """The training and its time without the evaluations on the way."""
    plugins = Plugins(*(registry.build(group, config[group]) for group in registry.GROUPS))
    near = options.near_plane * scene.training.near
    excluded = 0.0

    def test_psnr(current: Gaussians, background: Tensor, sh_degree: int) -> float | None:
        nonlocal excluded
        before = time.process_time()
        render = _renderer(current, background, sh_degree, near)
        values = [psnr(render(view.camera), view.image, view.mask) for view in scene.test]
        excluded += time.process_time() - before
        finite = [value for value in values if not isinstance(value, Missing)]
        return sum(finite) / len(finite) if len(finite) == len(values) else None

    before = time.process_time()
    trainer = Trainer(
        scene.training, depth, gaussians, options, plugins, int(config["seed"]), progress, test_psnr
    )
    trained = trainer.run()
    cpu_s = time.process_time() - before - excluded
    return trained, StageTime(trained.train_s, cpu_s)


def _renderer(
    gaussians: Gaussians, background: Tensor, sh_degree: int, near: float
) -> Callable[[Camera], Tensor]:
    """What evaluation sees: the Gaussians alone, without plugins or gradients."""

    def render(camera: Camera) -> Tensor:
        return rasterize(
            gaussians, camera, background=background, sh_degree=sh_degree, near=near
        ).rgb

    return render


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
    psnr_db, train_s = record.summary.get("psnr"), record.train_s
    quality = (
        "no test PSNR" if psnr_db is None or isinstance(psnr_db, Missing) else f"{psnr_db:.2f} dB"
    )
    seconds = "" if train_s is None else f" · {train_s:.1f} s of training"
    return f"test {quality} · {record.gaussians} Gaussians{seconds}"


@contextmanager
def _timed(timings: dict[str, StageTime], stage: str) -> Iterator[None]:
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    timings[stage] = StageTime(time.perf_counter() - wall, time.process_time() - cpu)
