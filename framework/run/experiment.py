"""One run: resolved configuration -> preparation, training, evaluation -> a record on disk.

A complete run with the same identity (configuration, scene, other files, code, packages) is reused
unless `force` is set.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from framework import registry
from framework.backends import Rasterizer, build_rasterizer
from framework.compute import parallel, rng
from framework.compute.stopwatch import Stopwatch
from framework.files.locks import locked, remove_stale
from framework.files.whole import following, remove_temporaries
from framework.metrics.coadaptation import with_average, with_coadaptation, with_rank
from framework.metrics.evaluate import evaluate
from framework.metrics.lpips import Lpips, load
from framework.metrics.lpips_weights import chosen, fingerprint
from framework.metrics.values import (
    COADAPTATION,
    LPIPS_BOTH,
    VIEWS,
    Missing,
    ViewMetrics,
    evenly,
    measures,
)
from framework.options import TrainerOptions
from framework.records.cameras import write_cameras
from framework.records.first_view import write_settings
from framework.records.notices import noted, warnings_of
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
    LEARNED,
    LPIPS,
    POSE_CHECK,
    TRAIN_STAGE,
    RunRecord,
    SceneInfo,
    StageTime,
    check_replaceable,
    damaged_file,
    find_complete,
    remove_record,
    write_run,
)
from framework.records.run_files import remove_made_of_model, write_photos
from framework.run import answers, budget, trackers
from framework.run.lpips_later import lacks_lpips, with_lpips
from framework.run.plugin_code import plugin_hashes
from framework.run.preparation import (
    Preparation,
    evened,
    forgotten_if_foreign,
    load_scene,
    options_of,
    prepare,
)
from framework.run.training import Run, initial, renderer, thinned, train, within_seconds
from framework.run.warmup import Warmup
from framework.shapes import check_kind
from framework.train import schedule
from framework.train.dose import summary as dose_summary
from framework.train.resume.checkpoint import remove_checkpoints
from framework.train.trainer import Trained
from framework.types import Gaussians, Scene, View

LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class Experiment:
    """A requested run.

    Attributes:
        config: plain and resolved, see `conf/config.yaml`.
        folder: where its record is written.
        overrides: the words of the command line.
        network: measures LPIPS, None for none.
    """

    config: Mapping[str, Any]
    folder: Path
    overrides: tuple[str, ...]
    rasterizer: Rasterizer
    network: Lpips | None
    progress: Progress
    warmup: Warmup

    def run(self, warnings: list[str]) -> RunRecord:
        """Run it, or reuse its complete record. `warnings` collects what is logged meanwhile."""
        self.progress.stage(f"scene {self.config['scene']['name']}")
        scene = load_scene(options_of(self.config, "scene")).result
        plugins = plugin_hashes(self.config)
        files = {**file_fingerprints(self.config, scene), **plugins}
        identity = identity_of(self.config, scene.fingerprint, code_hash(), files)
        complete = self._complete(identity)
        if complete is not None and not lacks_lpips(complete, self.network):
            self.progress.done(_reused(complete))
            remove_stale(self.folder, remove_checkpoints)  # of a run killed after its record
            return complete
        with locked(self.folder):
            # the process that held the lock before may have completed the run
            complete = self._complete(identity)
            if complete is not None:
                remove_checkpoints(self.folder)
                complete = with_lpips(self.folder, complete, self.network)
                self.progress.done(_reused(complete))
                return complete
            damage = "" if self.config["force"] else damaged_file(self.folder, identity)
            if damage:
                LOG.warning(f"{self.folder.name}: {damage}; running it again")
            remove_temporaries(self.folder)
            self._warn_of_unused()
            with forgotten_if_foreign(self.config):
                preparation = prepare(self.config, files["depth"], self.warmup, self.progress)
                warnings += preparation.warnings
                preparation = self._with_fewer_test_views(preparation)
                record = self._new_record(identity, plugins, preparation, len(scene.test))
                record = self._train(record, preparation, warnings)
        self.progress.done(_result(record))
        return record

    def _complete(self, identity: str) -> RunRecord | None:
        """The complete record of the same run, unless it is to be repeated. Raises UserError if the
        folder has one of another configuration."""
        check_replaceable(self.folder, self.config)
        return None if self.config["force"] else find_complete(self.folder, identity)

    def _warn_of_unused(self) -> None:
        """Warn about options that the user gave and that have no effect."""
        options = TrainerOptions(**self.config["trainer"])
        augmented = self.config["augment"]["name"] != "none"
        for line in schedule.unused(options, self.overrides, augmented=augmented):
            LOG.warning(line)

    def _with_fewer_test_views(self, preparation: Preparation) -> Preparation:
        """Keep `metrics.views` of the test views, evenly spread."""
        scene = preparation.scene
        test = evenly(scene.test, self.config["metrics"].get(VIEWS, 0))
        if len(test) < len(scene.test):
            self.progress.note(
                f"evaluates {len(test)} of {len(scene.test)} test views (metrics.views)"
            )
        return dataclasses.replace(preparation, scene=dataclasses.replace(scene, test=test))

    def _new_record(
        self, identity: str, plugins: Mapping[str, str], preparation: Preparation, n_test: int
    ) -> RunRecord:
        scene, check = preparation.scene, preparation.pose_check
        return RunRecord(
            identity=identity,
            config=dict(self.config),
            overrides=self.overrides,
            scene=SceneInfo(
                scene.name,
                scene.protocol,
                scene.fingerprint,
                tuple(view.name for view in scene.training.views),
                tuple(view.name for view in scene.test),
            ),
            timings=preparation.timings,
            provenance={
                **provenance(),
                "plugins": plugins,
                **self.rasterizer.facts(),
                "threads": parallel.threads(),
                "test_views": {"evaluated": len(scene.test), "of": n_test},
                LEARNED: _learned_weights(self.config),
                LPIPS: None if self.network is None else self.network.name,
                POSE_CHECK: None if check is None else check.figures(),
            },
        )

    def _train(
        self,
        record: RunRecord,
        preparation: Preparation,
        warnings: list[str],
    ) -> RunRecord:
        """Train and evaluate; returns the record as written."""
        exposures = preparation.exposures
        scene = evened(preparation.scene, exposures)
        timings, facts = preparation.timings, dict(record.provenance)
        if exposures is not None:
            self.progress.note(exposures.message())
            facts[EXPOSURE] = exposures.size

        def start(seed: int) -> Gaussians:
            trainer = TrainerOptions(**self.config["trainer"])
            with _timed(timings, "init"):
                return initial(self.config, scene, preparation.depth, trainer, seed)

        run = Run(
            scene,
            preparation.depth,
            start,
            self.folder,
            record.identity,
            self.config["force"],
            self.rasterizer,
            exposures,
        )
        config, chosen_steps = within_seconds(run, self.config, self.progress)
        if chosen_steps is not None:
            facts["budget"] = chosen_steps
        trained = train(run, config, self.progress)
        timings[TRAIN_STAGE] = StageTime(trained.wall_s, trained.cpu_s)
        self.progress.stage("evaluation")
        near = run.near(TrainerOptions(**config["trainer"]))
        with _timed(timings, "evaluate"):
            metrics, renders = self._evaluate(trained, run, near)
        record = dataclasses.replace(
            record,
            provenance=facts,
            peak_memory_bytes=peak_memory_bytes(),
            resumed=trained.resumed,
            dose=dose_summary(trained.dose),
            warnings=tuple(dict.fromkeys(warnings)),
        )
        return self._write(record, preparation, trained, near, metrics, renders)

    def _evaluate(
        self, trained: Trained, run: Run, near: float
    ) -> tuple[list[ViewMetrics], list[tuple[View, Tensor]]]:
        """Measure the trained model on the test views; also returns its renders of them."""
        model = trained.gaussians, trained.background, trained.sh_degree
        test, options = run.scene.test, self.config["metrics"]
        names = measures(options.get("also"))
        metrics, renders = evaluate(
            renderer(*model, near, run.rasterizer, run.exposures),
            test,
            self.network,
            {name: registry.part("metric", {"name": name}) for name in names},
            bool(options.get(LPIPS_BOTH)),
            self.progress.stage,
        )
        metrics = with_average(metrics)
        if options.get(COADAPTATION):
            half = thinned(*model, near, run.rasterizer)
            cameras = [view.camera for view in test]
            draws = rng.stream(self.config["seed"], COADAPTATION)
            metrics = with_coadaptation(metrics, half, len(trained.gaussians), cameras, draws)
            metrics = with_rank(metrics, trained.gaussians.log_scales)
        return metrics, renders

    def _write(
        self,
        record: RunRecord,
        preparation: Preparation,
        trained: Trained,
        near: float,
        metrics: list[ViewMetrics],
        renders: list[tuple[View, Tensor]],
    ) -> RunRecord:
        """Write the run's files; the record is last, as it marks the others as complete."""
        photos, exposures = preparation.scene.training.views, preparation.exposures
        stale = remove_record(self.folder)  # of an earlier run, with other files than these
        with following(self.folder) as before:
            factors = None if exposures is None else exposures.factors
            write_cameras(self.folder, photos, preparation.scene.test, near, factors)
            means, background = trained.gaussians.means, trained.background
            write_settings(self.folder, photos, means, background, near)
            write_photos(self.folder, photos)
        record = write_run(
            self.folder,
            record,
            metrics,
            trained.history,
            trained.gaussians,
            trained.background,
            renders,
            before,
            stale,
        )
        remove_checkpoints(self.folder)
        (self.folder / budget.FILE).unlink(missing_ok=True)
        remove_made_of_model(self.folder)
        return record


def run_experiment(
    config: Mapping[str, Any],
    run_dir: Path,
    progress: Progress,
    overrides: Sequence[str] = (),
) -> RunRecord:
    """Do one run, or reuse it, and leave its record in `run_dir`.

    Args:
        config: plain and resolved, see `conf/config.yaml`.
        run_dir: folder of the run.
        progress: shows what the framework logs meanwhile.
        overrides: the words that the user typed.

    Returns:
        The record as written.

    Raises:
        UserError: for any bad input; an older complete run is kept then.
        Busy: another process is at this run.
    """
    reset_peak_memory()
    parallel.set_threads(int(config["threads"]))
    torch.set_num_threads(1)  # kernels have their own pool; small tensors gain nothing from two
    registry.discover()
    rasterizer = build_rasterizer(config)
    rasterizer.ready()
    registry.part("depth", config["depth"]).ready()
    weights = chosen(config["metrics"]["lpips_weights"])
    network = None if weights is None else load(weights)  # a bad path must not cost a training
    with noted(progress), warnings_of() as warnings, Warmup(config, progress) as warmup:
        experiment = Experiment(
            config, run_dir, tuple(overrides), rasterizer, network, progress, warmup
        )
        record = experiment.run(warnings)
    trackers.send(config.get("tracker"), run_dir, progress)
    return record


def file_fingerprints(config: Mapping[str, Any], scene: Scene) -> dict[str, str]:
    """Fingerprints of the files that a run reads besides the scene's, by purpose; "" for none."""
    provider = registry.part("depth", config["depth"])
    return {
        "depth": answers.ask(
            f"depth={config['depth']['name']}: fingerprint",
            provider,
            partial(provider.fingerprint, scene.training),
            lambda value: check_kind("the fingerprint", value, str),
        ),
        "lpips_weights": fingerprint(config["metrics"]["lpips_weights"]),
    }


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
    """Add the time inside to that of the stage so far."""
    before, watch = timings.get(stage, StageTime(0.0, 0.0)), Stopwatch()
    yield
    timings[stage] = StageTime(before.wall_s + watch.wall_s, before.cpu_s + watch.cpu_s)


def _learned_weights(config: Mapping[str, Any]) -> str:
    """The weights of networks behind poses and depth; "" if there are none."""
    poses = getattr(registry.part("scene", config["scene"]), "learned_weights", "")
    depth = registry.part("depth", config["depth"]).learned_weights()
    return "; ".join(filter(None, (poses, depth)))
