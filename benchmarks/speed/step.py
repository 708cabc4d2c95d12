"""Milliseconds by stage of one training step, optionally compared with a prototype.

    python benchmarks/speed/step.py [--prototype DIR] [--clock cpu] [--output FILE]

The step is what training runs: `render_gradient` (SH degree 3) of `photometric_gradient` and of
smooth depth, and `Adam.step_from`, at 504x378 on `benchmarks.scene`. Stages are timed inside it;
the column `rest` is the time between them.

Every round runs in fresh processes, ours and the prototype's in turn. A turn has some steps with
one thread, some with two, and some with one thread next to a second process that does the same. The
speed-up of these two processes is what the machine could give at that time. Speed-ups are medians
over turns, `wall` is the median over all steps. `CPU` is the processor time of the whole process
per step, which other programs disturb less; `--clock cpu` also measures stages by it. Prints a
Markdown table, and writes it to FILE.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from subprocess import PIPE
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.speed.step_report import STAGES, Results, Steps, Turn, report

ROOT = Path(__file__).resolve().parents[2]
WARM_UP, TURN = 5, 5  # steps
SMOOTH = 0.01  # weight of smooth depth, the default
DECAY = 0.999999  # of opacities: the work of it, but the scene stays what it is
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
PROTOTYPE_LINE = re.compile(r"^(\d+) hash .*?wall/iter med ([\d.]+) .*?cpu/iter ([\d.]+)")


class Stopwatch:
    """Collects the duration of wrapped calls, in milliseconds by name."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.times: dict[str, list[float]] = {name: [] for name in STAGES}

    def wrap(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:
            start = self.clock()
            result = function(*args, **kwargs)
            self.times[name].append(1e3 * (self.clock() - start))
            return result

        return timed

    @contextmanager
    def watching(self, owner: type) -> Iterator[None]:
        """Time every method of `owner` that is a stage, while inside."""
        originals = {name: vars(owner)[name] for name in STAGES if name in vars(owner)}
        for name, method in originals.items():
            setattr(owner, name, self.wrap(name, method))
        try:
            yield
        finally:
            for name, method in originals.items():
                setattr(owner, name, method)


def work(options: argparse.Namespace) -> None:
    """Take turns: for every count print that it is ready, then take a turn for every line read,
    which has the number of threads."""
    import torch

    from framework.compute.parallel import set_threads
    from framework.kernels import Workspace

    torch.set_num_threads(1)  # as a run does: its idle threads would spin on the other core
    watch = Stopwatch(CLOCKS[options.clock])
    with watch.watching(Workspace):
        for count in options.counts:
            step = training_step(count, watch)
            for threads in options.threads:
                set_threads(threads)
                for _ in range(WARM_UP):
                    step()
            print("ready", flush=True)
            while threads := int(sys.stdin.readline()):
                set_threads(threads)
                print(json.dumps(asdict(take_turn(step, watch))), flush=True)


def take_turn(step: Callable[[], None], watch: Stopwatch) -> Steps:
    """TURN steps, after one that finds the caches as another number of threads left them."""
    steps = Steps({name: [] for name in STAGES}, [], [])
    step()
    for times in watch.times.values():
        times.clear()
    for _ in range(TURN):
        start, cpu_start = time.perf_counter(), time.process_time()
        step()
        steps.wall_ms.append(1e3 * (time.perf_counter() - start))
        steps.cpu_ms.append(1e3 * (time.process_time() - cpu_start))
    for name, times in watch.times.items():
        steps.stages[name] += times
    return steps


def training_step(count: int, watch: Stopwatch, factor: float = 1.0) -> Callable[[], None]:
    """A closure that does one step on its own Gaussians; factor: see `layered_scene`."""
    import torch

    from benchmarks.scene import layered_scene
    from framework.backends import NUMBA
    from framework.compute.rng import stream
    from framework.kernels import render_gradient
    from framework.kernels.losses import Target, photometric_gradient
    from framework.train.depth_priors import DepthSmoothness
    from framework.train.optim import Adam
    from framework.types import View

    gaussians, camera = layered_scene(count, factor=factor)
    rates = dict.fromkeys([name for name, _ in gaussians.items()], 1e-5)
    shape = (3, camera.height, camera.width)
    image = stream(0, "benchmark-target").random(shape, dtype="float32")
    photo = View("target", camera, torch.from_numpy(image))
    target, weights = Target.of(photo.image), DepthSmoothness(SMOOTH, 0.1).weights(photo)
    optimizer = Adam(gaussians)
    loss_of = watch.wrap("loss", photometric_gradient)
    pull_of = watch.wrap("roughness", NUMBA.losses().roughness_gradient)
    update = watch.wrap("update", optimizer.step_from)

    def step() -> None:
        gradient = render_gradient(
            gaussians,
            camera,
            lambda rgb: loss_of(rgb, target)[1],
            depth_gradient=lambda alpha, depth: pull_of(alpha, depth, weights),
        )
        update(gradient, rates, DECAY)

    return step


class Worker:
    """A process that takes turns on request."""

    def __init__(self, options: argparse.Namespace) -> None:
        command = [sys.executable, __file__, "--worker", "--clock", options.clock]
        command += ["--threads", *map(str, options.threads)]
        command += ["--counts", *map(str, options.counts)]
        environment = _environment(max(options.threads))
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=environment, text=True, stdin=PIPE, stdout=PIPE
        )

    def read(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit(f"step.py: a worker ended with code {self.process.wait()}, see above")
        return line

    def start(self, threads: int) -> None:
        """Begin a turn; 0 threads: go on to the next count."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{threads}\n")
        self.process.stdin.flush()

    def end(self) -> Steps:
        return Steps(**json.loads(self.read()))


def _run_ours(options: argparse.Namespace, results: Results) -> None:
    """All counts in two fresh processes; the second only loads the machine."""
    workers = Worker(options), Worker(options)
    first = workers[0]
    for count in options.counts:
        for worker in workers:
            worker.read()
        for _ in range(0, options.steps, TURN):
            turns: dict[int, Steps] = {}
            for threads in options.threads:
                first.start(threads)
                turns[threads] = first.end()
                results.ours.setdefault((count, threads), []).append(turns[threads])
            if {1, 2} <= turns.keys():
                first.start(1)
                again = first.end()
                for worker in workers:
                    worker.start(1)
                both = [worker.end() for worker in workers]
                results.turns.setdefault(count, []).append(Turn(turns[1], turns[2], again, both))
        for worker in workers:
            worker.start(0)
    for worker in workers:
        worker.process.wait()


def _run_prototype(folder: Path, threads: int, cache: Path) -> dict[int, tuple[float, float]]:
    """Median wall and mean CPU milliseconds per step by count, as the prototype prints them."""
    command = [sys.executable, "iter_full.py", "pool", str(threads)]
    environment = {**_environment(threads), "NUMBA_CACHE_DIR": str(cache)}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    output = subprocess.run(
        command, cwd=folder, env=environment, check=True, capture_output=True, text=True
    ).stdout
    lines = filter(None, map(PROTOTYPE_LINE.match, output.splitlines()))
    return {int(m[1]): (float(m[2]), float(m[3])) for m in lines}


def _environment(threads: int) -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": str(threads), "NUMBA_NUM_THREADS": str(threads)}


def run_rounds(options: argparse.Namespace) -> Results:
    """Ours and the prototype's in turn, `options.rounds` times."""
    results = Results({}, {}, {})
    with tempfile.TemporaryDirectory() as cache:
        for number in range(options.rounds):
            print(f"round {number + 1} of {options.rounds}", file=sys.stderr)
            _run_ours(options, results)
            for threads in options.threads if options.prototype is not None else []:
                timings = _run_prototype(options.prototype, threads, Path(cache))
                for count, pair in timings.items():
                    results.prototype.setdefault((count, threads), []).append(pair)
    return results


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Milliseconds by stage of one training step.")
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 50_000, 100_000])
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2])
    parser.add_argument(
        "--steps", type=int, default=15, help=f"measured per round, in turns of {TURN}"
    )
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--clock", choices=sorted(CLOCKS), default="wall", help="of the stages")
    parser.add_argument("--prototype", type=Path, help="folder with the prototype's iter_full.py")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.steps < TURN or options.steps % TURN:
        parser.error(f"--steps: expected a multiple of {TURN}, got {options.steps}")
    if options.prototype is not None and not (options.prototype / "iter_full.py").is_file():
        parser.error(f"--prototype: expected a folder with iter_full.py, got {options.prototype}")
    return options


def main() -> None:
    options = _options()
    if options.worker:
        work(options)
        return
    results = run_rounds(options)
    command = f"python benchmarks/speed/step.py --rounds {options.rounds} --steps {options.steps}"
    command += f" --clock {options.clock}" + (" --prototype DIR" if options.prototype else "")
    text = report(results, command, options.clock)
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
