"""What each method costs: seconds per training step relative to `augment=none reg=none`.

    python benchmarks/cost.py [--rounds N] [--out FILE] [OVERRIDE ...]

Whole trainings on one thread without evaluations, by default on the embedded scene; overrides are
those of `run.py`, for instance `scene=llff scene.path=DIR` or `trainer.steps=200`. In every round
each method trains once in a process of its own, in turn, so that a slow minute of the machine hits
all; a ratio is the median over the rounds of the method's time by the baseline's of the same round.
CPU is the processor time of the process, which other programs disturb less than wall time; kernels
are compiled, scene and depth loaded before the clocks start. What a method costs while it acts is
more than this mean over the training: `start` and `stop` leave it out of a part. Writes a markdown
table to results/cost.md.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

BASELINE = ("none", "none")
METHODS = [
    BASELINE,
    *[(name, "none") for name in ("dba", "euclidean", "full_set", "safi")],
    *[("none", name) for name in ("uniform", "uar_hard", "uar")],
    ("safi", "uar"),
]
LIMITS = {("safi", "none"): 1.5, ("none", "uar"): 1.2}  # ratios the project promises


@dataclass(frozen=True)
class Cost:
    """One training. cpu_ms, wall_ms: per step. gaussians: at its end."""

    cpu_ms: float
    wall_ms: float
    steps: int
    gaussians: int


def measure(augment: str, reg: str, overrides: Sequence[str]) -> Cost:
    """Train once in this process."""
    from hydra import compose, initialize_config_dir

    from framework import experiment, parallel, registry
    from framework.config import CONF_DIR, check, register_config
    from framework.naming import plain
    from framework.options import TrainerOptions
    from framework.progress import Silent
    from framework.trainer import Plugins, Trainer
    from framework.training import initial
    from framework.warmup import Warmup

    register_config()
    line = [*overrides, f"augment={augment}", f"reg={reg}"]
    with initialize_config_dir(config_dir=str(CONF_DIR), version_base="1.3"):
        config = plain(compose("config", line))
    check(config)
    parallel.set_threads(1)
    with Warmup(config, Silent()) as warmup:
        warmup.finish()
    key = experiment._key(config["scene"])
    scene, _ = experiment._scene(key)
    files = experiment._files(config, scene)
    depth, _ = experiment._depth(key, experiment._key(config["depth"]), files["depth"])
    options = TrainerOptions(**config["trainer"])
    gaussians = initial(config, scene, depth, options)
    plugins = Plugins(*(registry.build(group, config[group]) for group in registry.GROUPS))
    seed = int(config["seed"])
    trainer = Trainer(scene.training, depth, gaussians, options, plugins, seed, Silent())
    cpu, wall = time.process_time(), time.perf_counter()
    trained = trainer.run()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    n = options.steps
    return Cost(1e3 * cpu / n, 1e3 * wall / n, n, len(trained.gaussians))


def in_a_process(method: tuple[str, str], overrides: Sequence[str]) -> Cost:
    """`measure` in a fresh process."""
    command = [sys.executable, __file__, "--method", ",".join(method), *overrides]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    return Cost(**json.loads(done.stdout.splitlines()[-1]))


def report(rounds: list[dict[tuple[str, str], Cost]], command: str) -> str:
    """The markdown that is printed and written."""
    from framework.provenance import cpu_model

    first = rounds[0][BASELINE]
    lines = [
        "# What each method costs",
        "",
        f"`{command}` on {cpu_model()} ({os.cpu_count()} cores, one used), Python"
        f" {platform.python_version()}: {first.steps} steps, {first.gaussians} Gaussians,"
        f" {len(rounds)} rounds. Time per step over the whole training.",
        "",
        "| augment | reg | CPU ms | wall ms | CPU ratio | wall ratio | limit |",
        "|---|---|---:|---:|---:|---:|---:|",
        *(_row(method, rounds) for method in METHODS),
        "",
    ]
    return "\n".join(lines)


def _row(method: tuple[str, str], rounds: list[dict[tuple[str, str], Cost]]) -> str:
    own, base = ([costs[name] for costs in rounds] for name in (method, BASELINE))
    pairs = list(zip(own, base, strict=True))
    cells = [
        f"{statistics.median(cost.cpu_ms for cost in own):.1f}",
        f"{statistics.median(cost.wall_ms for cost in own):.1f}",
        f"{statistics.median(a.cpu_ms / b.cpu_ms for a, b in pairs):.2f}",
        f"{statistics.median(a.wall_ms / b.wall_ms for a, b in pairs):.2f}",
        f"{LIMITS[method]:.1f}" if method in LIMITS else "",
    ]
    return f"| {' | '.join([*method, *cells])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "cost.md")
    parser.add_argument("--method", help=argparse.SUPPRESS)  # AUGMENT,REG: measure and print
    args = parser.parse_intermixed_args()
    if args.method is not None:
        print(json.dumps(asdict(measure(*args.method.split(","), args.overrides))))
        return
    rounds = []
    for number in range(args.rounds):
        costs = {}
        for method in METHODS:
            costs[method] = in_a_process(method, args.overrides)
            print(f"round {number + 1}, {'+'.join(method)}: {costs[method]}", file=sys.stderr)
        rounds.append(costs)
    command = " ".join(["python benchmarks/cost.py", f"--rounds {args.rounds}", *args.overrides])
    text = report(rounds, command)
    args.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
