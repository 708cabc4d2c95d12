"""What each method costs: seconds per training step relative to `augment=none reg=none`.

    python benchmarks/speed/cost.py [--chunk N] [--output FILE] [OVERRIDE ...]

Whole trainings on one thread without evaluations, by default on the embedded scene. Overrides are
those of `run.py`, for instance `scene=llff scene.path=DIR` or `trainer.steps=200`. Every method
trains in a separate process. The processes take turns of `--chunk` steps, so that a slow minute of
the machine affects all of them. CPU is the processor time of the process, which other programs
disturb less than wall time. Kernels are compiled, scene and depth loaded before. The mean includes
steps outside the method's span. Prints a Markdown table, and writes it to FILE.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from framework.records.progress import Progress

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

Method = tuple[str, str]  # augmenter, regularizer

BASELINE: Method = ("none", "none")
METHODS: list[Method] = [
    BASELINE,
    *[(name, "none") for name in ("dba", "euclidean", "full_set", "safi")],
    *[("none", name) for name in ("uniform", "uar_hard", "uar")],
    ("safi", "uar"),
]
LIMITS = {("safi", "none"): 1.5, ("none", "uar"): 1.2}  # ratios the project promises


@dataclass(frozen=True)
class Turn:
    """Some steps of a training: what they took, which was the last, of how many."""

    cpu_s: float
    wall_s: float
    step: int
    n_steps: int
    gaussians: int


class Turns(Progress):
    """Lets a training go on for `chunk` steps per line on stdin, and answers with
    the `Turn` as JSON."""

    def __init__(self, chunk: int) -> None:
        self.chunk, self.cpu, self.wall = chunk, 0.0, 0.0

    def wait(self) -> None:
        """Block until it is our turn."""
        sys.stdin.readline()
        self.cpu, self.wall = time.process_time(), time.perf_counter()

    def step(
        self, step: int, n_steps: int, loss: float, gaussians: int, psnr: float | None = None
    ) -> None:
        if step % self.chunk == 0 or step == n_steps:
            cpu, wall = time.process_time() - self.cpu, time.perf_counter() - self.wall
            print(json.dumps(asdict(Turn(cpu, wall, step, n_steps, gaussians))), flush=True)
            if step < n_steps:
                self.wait()


def train(method: Method, overrides: Sequence[str], chunk: int) -> None:
    """Train once in this process, in turns; prints `ready` before the first."""
    from benchmarks.prepare import prepared
    from framework.compute import parallel

    parallel.set_threads(1)
    turns = Turns(chunk)
    line = [*overrides, f"augment={method[0]}", f"reg={method[1]}"]
    trainer = prepared(line).trainer(turns)
    print("ready", flush=True)
    turns.wait()
    trainer.run()


def ready(method: Method, overrides: Sequence[str], chunk: int) -> subprocess.Popen[str]:
    """A process that waits for its first turn with `method`."""
    arguments = ["--method", ",".join(method), "--chunk", str(chunk)]
    process = subprocess.Popen(
        [sys.executable, __file__, *arguments, *overrides],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    if process.stdout.readline() != "ready\n":
        raise SystemExit(f"error: {'+'.join(method)} did not start; see above")
    return process


def turn_of(process: subprocess.Popen[str]) -> Turn:
    """Let a process go on for one turn."""
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write("\n")
    process.stdin.flush()
    return Turn(**json.loads(process.stdout.readline()))


def compared(overrides: Sequence[str], chunk: int) -> dict[Method, list[Turn]]:
    """All turns of all methods."""
    processes: dict[Method, subprocess.Popen[str]] = {}
    turns: dict[Method, list[Turn]] = {method: [] for method in METHODS}
    try:
        for method in METHODS:
            processes[method] = ready(method, overrides, chunk)
        while not turns[BASELINE] or turns[BASELINE][-1].step < turns[BASELINE][-1].n_steps:
            for method in METHODS:
                turns[method].append(turn_of(processes[method]))
            print(f"step {turns[BASELINE][-1].step}", file=sys.stderr)
    finally:
        for process in processes.values():
            process.kill()
            process.wait()
    return turns


def report(turns: dict[Method, list[Turn]], command: str) -> str:
    """The markdown that is printed and written."""
    from framework.records.provenance import cpu_model

    last = turns[BASELINE][-1]
    lines = [
        "# What each method costs",
        "",
        f"`{command}` on {cpu_model()} ({os.cpu_count()} cores, one used), Python"
        f" {platform.python_version()}: milliseconds per step over a training of {last.n_steps}"
        f" steps with {last.gaussians} Gaussians, and the ratio to the plain trainer's.",
        "",
        "| augment | reg | CPU ms | wall ms | CPU ratio | wall ratio | limit |",
        "|---|---|---:|---:|---:|---:|---:|",
        *(_row(method, turns) for method in METHODS),
        "",
    ]
    return "\n".join(lines)


def _row(method: Method, turns: dict[Method, list[Turn]]) -> str:
    cpu, wall = _per_step(turns[method])
    base_cpu, base_wall = _per_step(turns[BASELINE])
    limit = f"{LIMITS[method]:.1f}" if method in LIMITS else ""
    numbers = [f"{cpu:.1f}", f"{wall:.1f}", f"{cpu / base_cpu:.2f}", f"{wall / base_wall:.2f}"]
    return f"| {' | '.join([*method, *numbers, limit])} |"


def _per_step(turns: list[Turn]) -> tuple[float, float]:
    """CPU and wall milliseconds per step."""
    n = turns[-1].n_steps
    return 1e3 * sum(t.cpu_s for t in turns) / n, 1e3 * sum(t.wall_s for t in turns) / n


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("overrides", nargs="*", metavar="OVERRIDE", default=[])
    parser.add_argument("--chunk", type=int, default=10, help="steps per turn")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--method", help=argparse.SUPPRESS)  # AUGMENT,REG: be one of the processes
    args = parser.parse_intermixed_args()
    if args.method is not None:
        augment, reg = args.method.split(",")
        train((augment, reg), args.overrides, args.chunk)
        return
    words = ["python benchmarks/speed/cost.py", *args.overrides]
    text = report(compared(args.overrides, args.chunk), " ".join(words))
    print(text)
    if args.output is not None:
        args.output.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
