"""How long a study will take on this machine, told before its first run.

A few short trials measure what a run of each method and of each scene costs: seconds per step,
what is done once per run (start, evaluation, files), and what is done once per scene (loading,
depth). A run's time is taken as the product of its method's and its scene's share, so that not
every pair is tried. Trials leave nothing behind but compiled kernels and cached scenes.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from framework.compute.stopwatch import Stopwatch, duration
from framework.records.progress import Silent, say, unwarned
from framework.records.provenance import NEUTRAL_KEYS

TRIAL_STEPS = 24
MOST_TRIALS = 8
KEPT_SCENES = 2  # so many does `framework.run.experiment` keep from run to run
NOT_TIMED = ("seed", "scene", "depth", *NEUTRAL_KEYS)

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    """Seconds of a run: per training step, once per run, and once per scene and depth."""

    step_s: float
    run_s: float
    scene_s: float


def announce(configs: Sequence[Config], at_once: int = 1) -> float:
    """Print about how long runs of these configurations will take together; returns the seconds.

    at_once: how many runs the launcher does at a time.
    """
    say(f"estimate: trying out {min(MOST_TRIALS, len(configs))} short runs at most ...")
    seconds, trials = estimate(configs, measure)
    share = f", {at_once} at a time" if at_once > 1 else ""
    say(
        f"estimate: about {duration(seconds / at_once)} for {len(configs)} runs{share} (from"
        f" {trials} trials of {TRIAL_STEPS} steps; runs that are already complete take no time)"
    )
    return seconds / at_once


def estimate(configs: Sequence[Config], try_out: Callable[[Config], Cost]) -> tuple[float, int]:
    """Seconds of all runs, one after another, and the number of trials."""
    first = configs[0]
    base = try_out(first)
    by_method, by_scene = {_method(first): base}, {_scene(first): base}
    here = {key: first[key] for key in ("scene", "depth")}
    for config in configs:
        key = _method(config)
        if key not in by_method and len(by_method) < MOST_TRIALS // 2:
            by_method[key] = try_out({**config, **here})
    for config in configs:
        key = _scene(config)
        if key not in by_scene and len(by_method) + len(by_scene) <= MOST_TRIALS:
            there = {name: config[name] for name in here}
            by_scene[key] = try_out({**first, **there})
    usual, usually = _mean(by_method.values()), _mean(by_scene.values())
    total, kept = 0.0, [_scene(first)]  # the trials leave the first scene ready
    for config in configs:
        key = _scene(config)
        total += 0.0 if key in kept else by_scene.get(key, usually).scene_s
        kept = [*(other for other in kept if other != key), key][-KEPT_SCENES:]
        method, scene = by_method.get(_method(config), usual), by_scene.get(_scene(config), usually)
        step_s = method.step_s * scene.step_s / base.step_s
        trainer = config["trainer"]
        views = config["scene"].get("n_views")
        visits = int(trainer.get("visits") or 0) * (views if isinstance(views, int) else 0)
        total += trainer.get("seconds") or step_s * max(int(trainer["steps"]), visits)
        total += scene.run_s
    return total, len(by_method) + len(by_scene) - 1


def measure(config: Config) -> Cost:
    """Run `config` with few steps in a folder that goes again. The first run of a process waits for
    its kernels, so the trial is the second one."""
    from framework.run.experiment import run_experiment

    trainer = {**config["trainer"], "steps": TRIAL_STEPS, "visits": 0, "seconds": 0.0}
    short = {**config, "trainer": trainer, "force": True, "tracker": None}
    with unwarned(), tempfile.TemporaryDirectory(prefix="trial-") as folder:
        first = run_experiment(short, Path(folder) / "run", Silent())
        watch = Stopwatch()
        record = run_experiment(short, Path(folder) / "run", Silent())
        wall_s = watch.wall_s
    train_s = record.timings["train"].wall_s
    scene_s = first.timings["scene"].wall_s + first.timings["depth"].wall_s
    return Cost(train_s / TRIAL_STEPS, max(0.0, wall_s - train_s), scene_s)


def _method(config: Config) -> str:
    """All that a step's time may depend on, beside the scene and the number of steps."""
    kept = {key: value for key, value in config.items() if key not in NOT_TIMED}
    trainer = {key: value for key, value in config["trainer"].items() if key != "steps"}
    return json.dumps({**kept, "trainer": trainer}, sort_keys=True)


def _scene(config: Config) -> str:
    return json.dumps([config["scene"], config["depth"]], sort_keys=True)


def _mean(costs: Any) -> Cost:
    known = list(costs)
    sums = [sum(getattr(cost, name) for cost in known) for name in ("step_s", "run_s", "scene_s")]
    return Cost(*(total / len(known) for total in sums))
