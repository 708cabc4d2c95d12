"""How a training step's time grows with the Gaussians and the pixels.

    python benchmarks/speed/scaling.py [--counts N ...] [--factors F ...] [--rounds 3] \\
        [--output FILE]

The step and the scene are those of `step.py` (SH of degree 3); a factor scales both sides of
504x378. A contribution is a pair of a pixel and a Gaussian that is blended into it; more Gaussians
in the same image are mostly hidden: projected and sorted into tiles, but not blended. The last line
compares the growth of time with that of Gaussians and pixels. Writes a Markdown table to FILE, or
prints it.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.scene import layered_scene
from benchmarks.speed.step import WARM_UP, Stopwatch, training_step
from framework.compute.parallel import set_threads
from framework.kernels import borrow, give_back, rasterize
from framework.kernels.constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN
from framework.records.provenance import cpu_model


@numba.njit
def _count(width: int, height: int, rows: Any, offsets: Any, lists: Any, limits: Any) -> int:
    """Blended pairs, by the rules of `kernels.tile.tiles.composite`, a pixel at a time."""
    least, most, stop = limits
    columns, total = (width + 15) // 16, 0
    for tile in range(len(offsets) - 1):
        x0, y0 = (tile % columns) * 16, (tile // columns) * 16
        for y in range(y0, min(y0 + 16, height)):
            for x in range(x0, min(x0 + 16, width)):
                left = 1.0
                for k in range(offsets[tile], offsets[tile + 1]):
                    row = rows[lists[k, 0] >> 8]
                    dx, dy = x + 0.5 - row[0], y + 0.5 - row[1]
                    power = (row[3] * dy + row[2] * dx) * dx + row[4] * dy * dy + row[5]
                    alpha = min(2.0**power, most)
                    if alpha < least:
                        continue
                    if left * (1 - alpha) < stop:
                        break
                    left *= 1 - alpha
                    total += 1
    return total


def contributions(count: int, factor: float) -> int:
    """Pairs of pixel and Gaussian that one render of the scene blends."""
    gaussians, camera = layered_scene(count, factor=factor)
    work = borrow()  # the one that `rasterize` borrows next
    give_back(work)
    rasterize(gaussians, camera)
    limits = np.array([ALPHA_MIN, ALPHA_MAX, TRANSMITTANCE_MIN])
    return int(_count(camera.width, camera.height, work.rows, work.offsets, work.lists, limits))


def milliseconds(count: int, factor: float, threads: int, steps: int) -> list[float]:
    """Wall times of steps."""
    set_threads(threads)
    step = training_step(count, Stopwatch(time.perf_counter), factor)
    for _ in range(WARM_UP):
        step()
    times = []
    for _ in range(steps):
        start = time.perf_counter()
        step()
        times.append(1e3 * (time.perf_counter() - start))
    return times


def steepest(times: dict[tuple[float, int], float], axis: int) -> float:
    """The most that time grew from a case to its larger neighbour, in units of the growth of its
    pixels (axis 0, squared factors) or Gaussians (axis 1)."""
    grown = []
    for case, time_ms in times.items():
        larger = [c for c in times if c[1 - axis] == case[1 - axis] and c[axis] > case[axis]]
        if larger:
            other = min(larger, key=lambda c: c[axis])
            size = (other[axis] / case[axis]) ** (2 - axis)
            grown.append(times[other] / time_ms / size)
    return max(grown, default=float("nan"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 50_000, 100_000, 300_000])
    parser.add_argument("--factors", type=float, nargs="+", default=[0.5, 1.0, 2.0])
    parser.add_argument("--rounds", type=int, default=3, help="over all cases, each in its turn")
    parser.add_argument("--steps", type=int, default=7, help="measured steps of a case in a round")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)  # as a run does: its idle threads would spin on the other core
    sizes = [(factor, count) for factor in options.factors for count in options.counts]
    times: dict[tuple[float, int, int], list[float]] = defaultdict(list)
    for turn in range(options.rounds):
        for factor, count in sizes:
            for threads in (1, 2):
                step_ms = milliseconds(count, factor, threads, options.steps)
                times[factor, count, threads] += step_ms
        print(f"round {turn + 1} of {options.rounds}", file=sys.stderr, flush=True)
    lines = [
        "# How a training step grows",
        "",
        f"`python benchmarks/speed/scaling.py` on {cpu_model()}: medians of {options.steps} steps"
        f" in each of {options.rounds} rounds, ms; ns per blended contribution (pixel and"
        " Gaussian) of a step on one thread.",
        "",
        "| image | Gaussians | contributions (M) | 1 thread | 2 threads | speed-up | ns each |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    alone: dict[tuple[float, int], float] = {}
    for factor, count in sizes:
        pairs = contributions(count, factor)
        one, two = (statistics.median(times[factor, count, threads]) for threads in (1, 2))
        alone[factor, count] = one
        size = f"{round(504 * factor)}x{round(378 * factor)} | {count:,} | {pairs / 1e6:.1f}"
        speed = f"{one:.0f} | {two:.0f} | {one / two:.2f} | {1e6 * one / pairs:.2f}"
        lines.append(f"| {size} | {speed} |")
    lines += [
        "",
        "From a case to the next larger one, on one thread, time grows at most"
        f" {steepest(alone, 1):.2f} times as much as the Gaussians and {steepest(alone, 0):.2f}"
        " times as much as the pixels.",
    ]
    text = "\n".join(lines) + "\n"
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
