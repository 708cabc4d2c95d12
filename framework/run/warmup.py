"""Compile every kernel a run will need before anything is timed, or load it before a training is.

Kernels are compiled on first use and kept on disk. So the first run of a checkout does a few steps
on three tiny synthetic views with the same depth provider, trainer options and plugins. It shows
that it compiles, and how long that took. Later processes load the kernels in a moment. A process
compiles one kernel at a time, so a second process compiles those of the depth provider.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from framework import registry
from framework.backends import Rasterizer, build_rasterizer
from framework.compute.compiling import noticed
from framework.compute.jit import KERNEL_CACHE
from framework.compute.parallel import alone, threads
from framework.options import TrainerOptions
from framework.records.notices import QUIET
from framework.records.progress import Progress, Silent, unwarned
from framework.records.provenance import cpu_model
from framework.run.plane import textured_plane
from framework.train.epoch import Items
from framework.train.gradient import Rendering, screen_gradient, view_gradient
from framework.train.torch_adam import optimizer_of
from framework.train.trainer import Plugins, Trainer
from framework.types import DepthMap, Gaussians, TrainingSet, View

STEPS, LOAD_STEPS = 12, 6
FIRST = "kernels: once per checkout, a minute or two on two idle cores"

_warm: set[str] = set()  # keys this process has warmed up


class Warmup:
    """The warm-up of one configuration; does nothing a second time in a process.

    Enter it as early as possible, call `begin()` before anything is timed and `finish()` before the
    training. `begin` compiles kernels that were never compiled. Compiled kernels are loaded: those
    of the depth provider by `begin`, the rest in a thread until `finish`. Loading occupies the
    interpreter, depth the kernels, so they overlap. So the time of a process's first depth includes
    it.
    """

    def __init__(self, config: Mapping[str, Any], progress: Progress) -> None:
        self.config, self.progress = config, progress
        depth = {"depth": config["depth"]["name"]}
        chosen = depth | {group: config[group]["name"] for group in registry.GROUPS}
        chosen |= {"sh_degree": config["trainer"]["sh_degree"], "init": config["init"]["name"]}
        chosen |= {"rasterizer": build_rasterizer(config).name}
        chosen |= {key: config["trainer"][key] > 0 for key in ("depth_smoothness", "binocular")}
        # an option's value may call another kernel: warmed up once per process
        self.key = _key(chosen | {group: config[group] for group in (*registry.GROUPS, "depth")})
        self.markers = [KERNEL_CACHE / f"warm-{_key(names)}" for names in (chosen, depth)]
        self.beside: subprocess.Popen[bytes] | None = None
        self.compiles = self.key not in _warm and not all(m.exists() for m in self.markers)
        if self.compiles and not self.markers[1].exists():
            self.beside = _start_beside(config["depth"])
        self.loading: threading.Thread | None = None
        self.announced = False

    def __enter__(self) -> Warmup:
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the thread and the process of a run that ends early."""
        if self.loading is not None:
            self.loading.join()
        if self.beside is not None and self.beside.poll() is None:
            self.beside.terminate()
            self.beside.wait()

    def begin(self) -> None:
        """Compile what is missing, or start to load it."""
        if self.key in _warm:
            return
        if self.compiles:
            with noticed(self._announce) as compiled:
                self._compile()
            if compiled.kernels:
                self.progress.note(
                    f"{compiled.kernels} kernels compiled in {compiled.seconds:.0f} s"
                )
            return
        _estimate(self.config["depth"], textured_plane(0)[0])
        if threads() == 1:
            with unwarned():
                self._load()
        else:
            self.loading = threading.Thread(target=self._load, name=QUIET)
            self.loading.start()

    def finish(self) -> None:
        """Wait until all is loaded."""
        if self.loading is not None:
            self.loading.join()
        _warm.add(self.key)

    def _load(self) -> None:
        training, depth, gaussians = textured_plane(int(self.config["trainer"]["sh_degree"]))
        with alone():
            _initialize(self.config["init"], training, depth)
            with contextlib.suppress(Exception):  # it fails again in the run, with a message
                _train(self.config, training, depth, gaussians, LOAD_STEPS)

    def _announce(self) -> None:
        """Show once that kernels are compiled."""
        if not self.announced:
            self.announced = True
            self.progress.compiling(FIRST)

    def _compile(self) -> None:
        training, depth, gaussians = textured_plane(int(self.config["trainer"]["sh_degree"]))
        done = False
        # a broken plugin fails again, on the user's scene
        with contextlib.suppress(Exception), unwarned():
            _train(self.config, training, depth, gaussians, STEPS)
            done = True
        if self.beside is not None:
            if self.beside.poll() is None:
                self._announce()
            self.beside.wait()  # if it failed, the next line compiles
        _estimate(self.config["depth"], training)
        _initialize(self.config["init"], training, depth)
        for marker in self.markers if done else ():
            marker.parent.mkdir(parents=True, exist_ok=True)
            marker.touch()


def _key(chosen: Mapping[str, Any]) -> str:
    """Hash of what was compiled, the CPU and the checkout: numba's cache keys files by path."""
    text = json.dumps(dict(chosen), sort_keys=True, default=str)
    return hashlib.sha256(f"{text} {cpu_model()} {__file__}".encode()).hexdigest()[:16]


def _start_beside(depth: Mapping[str, Any]) -> subprocess.Popen[bytes]:
    """A process that compiles the kernels of a depth provider into the shared cache."""
    root = str(Path(__file__).resolve().parents[2])
    paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "framework.run.warmup", json.dumps(dict(depth), default=str)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def _estimate(depth: Mapping[str, Any], training: TrainingSet) -> None:
    # a provider that reads files has none for synthetic views
    with contextlib.suppress(Exception):
        registry.part("depth", depth).estimate(training)


def _initialize(
    init: Mapping[str, Any], training: TrainingSet, depth: tuple[DepthMap, ...]
) -> None:
    with contextlib.suppress(Exception):  # it fails again in the run, with a message
        registry.part("init", init).build(training, depth, 0, 0)


def _train(
    config: Mapping[str, Any],
    training: TrainingSet,
    depth: tuple[DepthMap, ...],
    gaussians: Gaussians,
    steps: int,
) -> None:
    options = dataclasses.replace(
        TrainerOptions(**config["trainer"]),
        steps=steps,
        sh_every=1,
        evaluations=1,
        pace_steps=0,  # else so short a training does without the second camera
        binocular_from=0.0,
    )
    # also what the user lets act for a short while only
    plugins = Plugins.of(config).always()
    rasterizer = build_rasterizer(config)
    values = training, depth, gaussians, options, plugins, 0, Silent()
    Trainer(*values, warns=False, rasterizer=rasterizer).run()
    _update(training.views[0], gaussians.clone().to(rasterizer.device), rasterizer)


def _update(view: View, gaussians: Gaussians, rasterizer: Rasterizer) -> None:
    """Both ways of a gradient to the parameters: plugins and their draws decide which a step takes,
    in a run perhaps another than in these few steps."""
    item, adam = Items(rasterizer=rasterizer).get(view, 1), optimizer_of(rasterizer, gaussians)
    rates = dict.fromkeys(dict(gaussians.items()), 0.0)
    rendering = Rendering(rasterizer=rasterizer)
    adam.step_from(screen_gradient(gaussians, item, "warm-up", rendering)[1], rates)
    adam.step(gaussians, view_gradient(gaussians, item, "warm-up", rendering)[1], rates)


if __name__ == "__main__":
    _estimate(json.loads(sys.argv[1]), textured_plane(0)[0])
