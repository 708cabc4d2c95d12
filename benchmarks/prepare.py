"""A training made ready in this process from overrides as `run.py` takes them; for benchmarks."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import torch  # noqa: E402
from hydra import compose, initialize_config_dir  # noqa: E402

from framework.command.config.check import check  # noqa: E402
from framework.command.config.naming import plain  # noqa: E402
from framework.command.config.schema import CONF_DIR, register_config  # noqa: E402
from framework.options import TrainerOptions  # noqa: E402
from framework.records.progress import Progress, Silent  # noqa: E402
from framework.run import preparation  # noqa: E402
from framework.run.experiment import file_fingerprints  # noqa: E402
from framework.run.training import Run, initial, train  # noqa: E402
from framework.run.warmup import Warmup  # noqa: E402
from framework.train import schedule  # noqa: E402
from framework.train.trainer import Evaluate, Plugins, Trained, Trainer  # noqa: E402
from framework.types import DepthMap, Gaussians, Scene  # noqa: E402


@dataclass(frozen=True)
class Prepared:
    """All that a training needs, with kernels compiled, scene and depth loaded."""

    config: dict[str, Any]
    scene: Scene
    depth: tuple[DepthMap, ...]

    def trainer(
        self, progress: Progress | None = None, evaluate: Evaluate | None = None
    ) -> Trainer:
        """A new training from the same start, of which the caller sees every step."""
        options, seed = TrainerOptions(**self.config["trainer"]), int(self.config["seed"])
        n_views = len(self.scene.training.views)
        members = schedule.shared(options, n_views).members
        if members > 1:
            raise SystemExit(f"expected trainer.members=1, got {members}: one is seen here")
        gaussians = initial(self.config, self.scene, self.depth, options, seed)
        plugins = Plugins.of(self.config)
        return Trainer(
            self.scene.training,
            self.depth,
            gaussians,
            options,
            plugins,
            seed,
            progress or Silent(),
            evaluate,
        )

    def trained(self) -> Trained:
        """What a run trains, all its members, without a look at the test views; photos are as they
        were exposed (`trainer.exposure` is the run's)."""
        options, scene = TrainerOptions(**self.config["trainer"]), replace(self.scene, test=())

        def start(seed: int) -> Gaussians:
            return initial(self.config, scene, self.depth, options, seed)

        with tempfile.TemporaryDirectory() as folder:
            run = Run(scene, self.depth, start, Path(folder), "benchmark", force=False)
            return train(run, self.config, Silent())


def configured(overrides: Sequence[str]) -> dict[str, Any]:
    """The plain, checked configuration of a single run."""
    register_config()
    with initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
        config: dict[str, Any] = plain(compose("config", list(overrides)))
    check(config)
    return config


def prepared(overrides: Sequence[str]) -> Prepared:
    """Raises UserError on bad input, as `run.py` does."""
    torch.set_num_threads(1)  # as a run does
    config = configured(overrides)
    with Warmup(config, Silent()) as warmup:
        warmup.begin()
        warmup.finish()
    key = preparation.options_of(config, "scene")
    scene = preparation.load_scene(key).result
    fingerprint = file_fingerprints(config, scene)["depth"]
    depth = preparation.estimate_depth(
        key, preparation.options_of(config, "depth"), fingerprint
    ).result
    return Prepared(config, scene, depth)
