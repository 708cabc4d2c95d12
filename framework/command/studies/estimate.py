"""About how long a study will take on this machine, for `estimate=true`.

A few short trials measure what a run costs: seconds per step, what is done once per run (start,
evaluation, files) and what is done once per scene (loading, depth). Configurations that were not
tried are taken to cost the mean. Trials leave nothing behind but compiled kernels and cached
scenes.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from framework.compute.stopwatch import Stopwatch, duration
from framework.records.progress import Silent, say, unwarned
from framework.records.provenance import NEUTRAL_KEYS

TRIAL_STEPS = 24
MOST_TRIALS = 8

Config = Mapping[str, Any]


@dataclass(frozen=True)
class Cost:
    """Seconds of a run: per training step, once per run, and once per scene and depth."""

    step_s: float
    run_s: float
    scene_s: float


def announce(configs: Sequence[Config], at_once: int = 1) -> float:
    """Print about how long runs of these configurations will take together; returns the seconds.

    Args:
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


def estimate(configs: Sequence[Config], measure: Callable[[Config], Cost]) -> tuple[float, int]:
    """Seconds of all runs, one after another, and the number of trials."""
    distinct = {_method(config): config for config in configs}
    every = max(1, -(-len(distinct) // MOST_TRIALS))
    costs = {key: measure(distinct[key]) for key in list(distinct)[::every]}
    parts = zip(*map(astuple, costs.values()), strict=True)
    mean = Cost(*(fmean(seconds) for seconds in parts))
    total = sum(_seconds(config, costs.get(_method(config), mean)) for config in configs)
    scenes = {json.dumps([config["scene"], config["depth"]]) for config in configs}
    return total + (len(scenes) - 1) * mean.scene_s, len(costs)  # the trials load one


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


def _seconds(config: Config, cost: Cost) -> float:
    """Seconds of a run whose scene is loaded."""
    trainer, views = config["trainer"], config["scene"].get("n_views")
    visits = int(trainer.get("visits") or 0) * (views if isinstance(views, int) else 0)
    steps = max(int(trainer["steps"]), visits)
    return float(trainer.get("seconds") or cost.step_s * steps) + cost.run_s


def _method(config: Config) -> str:
    """The options that the cost of a step may depend on."""
    options = {key: value for key, value in config.items() if key not in ("seed", *NEUTRAL_KEYS)}
    trainer = {key: value for key, value in config["trainer"].items() if key != "steps"}
    return json.dumps({**options, "trainer": trainer}, sort_keys=True)
