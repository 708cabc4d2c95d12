"""Which fraction of a core's peak the blending kernels reach.

    python benchmarks/speed/peak.py [--output FILE]

The peak is that of a loop of independent multiply-adds in registers. The operations of the kernels
are counted on `benchmarks.scene` (504x378): rows of sixteen pixels that a Gaussian meets, runs of
rows that begin with an exponential, and list items. An addition, a product, a quotient, a minimum
and a comparison are one operation, a multiply-add is two; selections, loads, stores and integer
work are none. All on one thread, in turns of one process, by CPU time.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.scene import layered_scene
from framework.compute import parallel
from framework.compute.jit import kernel
from framework.compute.simd import fma, load, select, splat, store, zeros
from framework.kernels import rendered
from framework.kernels.pipeline import Image
from framework.kernels.tile.tiles import (
    CHECK,
    aligned,
    alive_rows,
    blend_limits,
    blend_row,
    clear_outside,
    first_alphas,
    listed_rows,
    next_run,
    run_of,
    seen_from,
)
from framework.records.provenance import cpu_model

ONE = np.float32(1)
LANES, LOOPS, TURNS = 16, 2_000_000, 9
# operations per lane, read off the kernels: `blend_row` and the recurrence of alpha; colours, depth
FORWARD_ROW = 7 + 2 + 3 * 2 + 2
# the same and the gradient along the colour, depth and alpha, rest, slope, pull, moments and sums
BACKWARD_ROW = 7 + 5 + 5 + 2 + 4 + 2 + 5 + 6 + 3
RUN = 2 * 7 + 5 + 5 + 1 + 2 * 15  # `first_alphas` with two exponentials
FORWARD_ITEM, BACKWARD_ITEM = 4, 4 + 4 + 4 * 15  # `seen_from`; also the sums over lanes
COUNTS = (20_000, 50_000, 100_000)


@kernel
def multiply_add(loops, out):
    """Sixteen independent chains of multiply-adds."""
    x, y = splat(out[0]), splat(out[1])
    a, b, c, d = x, x + x, x - y, y
    e, f, g, h = a + y, b + y, c + y, d + y
    i, j, k, m = e + x, f + x, g + x, h + x
    n, o, p, q = i + y, j + y, k + y, m + y
    for _ in range(loops):
        a, b, c, d = fma(a, x, y), fma(b, x, y), fma(c, x, y), fma(d, x, y)
        e, f, g, h = fma(e, x, y), fma(f, x, y), fma(g, x, y), fma(h, x, y)
        i, j, k, m = fma(i, x, y), fma(j, x, y), fma(k, x, y), fma(m, x, y)
        n, o, p, q = fma(n, x, y), fma(o, x, y), fma(p, x, y), fma(q, x, y)
    total = ((a + b) + (c + d)) + ((e + f) + (g + h))
    store(out, 0, total + (((i + j) + (k + m)) + ((n + o) + (p + q))))


@kernel
def count_work(width, height, rows, offsets, lists, counts):
    """Count rows, runs and items as `blend` visits them, and the pixels that blend."""
    lit = aligned(16)
    columns = (width + 15) // 16
    transmittance = aligned(256)
    limits = blend_limits()
    for tile in range(len(offsets) - 1):
        x, y = (tile % columns) * 16, (tile // columns) * 16
        clear_outside(transmittance, x, y, width, height)
        store(lit, 0, zeros())
        for k in range(offsets[tile], offsets[tile + 1]):
            if (k - offsets[tile]) % CHECK == 0:
                alive = alive_rows(transmittance)
                if alive == 0:
                    break
            along = lists[k, 0]
            g, todo = along >> 8, listed_rows(along) & alive
            placed = seen_from(rows, g, x, y)
            bend, longest, lean = run_of(rows, g)
            counts[2] += 1
            while todo != 0:
                row, count, todo = next_run(todo, longest)
                raw, ratio = first_alphas(placed, lean, row, count)
                counts[0] += count
                counts[1] += 1
                for at in range(row * 16, (row + count) * 16, 16):
                    _, _, blends, left = blend_row(load(transmittance, at), raw, limits)
                    store(transmittance, at, left)
                    store(lit, 0, load(lit, 0) + select(blends, splat(ONE), zeros()))
                    raw, ratio = raw * ratio, ratio * bend
        counts[3] += int(lit.sum())


def timed(function: Callable[[], Any]) -> float:
    """CPU seconds of a call."""
    start = time.process_time()
    function()
    return time.process_time() - start


def row_of(n: int) -> str:
    """The table's row for a scene of n Gaussians."""
    gaussians, camera = layered_scene(n)
    h, w = camera.height, camera.width
    work, image, _ = rendered(gaussians, camera, None, None, 0.01, with_depth=True)
    gradient = Image(np.ones((3, h, w), np.float32), *np.ones((2, h, w), np.float32))
    background = np.zeros(3, np.float32)
    counts = np.zeros(4, np.int64)
    count_work(w, h, work.rows, work.offsets, work.lists, counts)
    rows, runs, items, blended = map(int, counts)
    forward = LANES * (rows * FORWARD_ROW + runs * RUN + items * FORWARD_ITEM)
    backward = LANES * (rows * BACKWARD_ROW + runs * RUN + items * BACKWARD_ITEM)
    out = np.array([0.999, 1e-6, *[0.0] * 14], np.float32)
    stages = {
        "peak": lambda: multiply_add(LOOPS, out),
        "forward": lambda: work.blend(background, image),
        "backward": lambda: work.blend_backward(image, gradient),
    }
    seconds = {name: [timed(stage) for _ in range(2)][1:] for name, stage in stages.items()}
    for _ in range(TURNS):
        for name, stage in stages.items():
            seconds[name].append(timed(stage))
    median = {name: statistics.median(values) for name, values in seconds.items()}
    peak = LOOPS * 16 * LANES * 2 / median["peak"] / 1e9
    rates = [forward / median["forward"] / 1e9, backward / median["backward"] / 1e9]
    cells = [f"{n:,}", f"{rows * LANES / (h * w):.0f}", f"{rows / runs:.1f}"]
    cells += [f"{100 * blended / (rows * LANES):.0f} %", f"{peak:.0f}"]
    for rate, stage in zip(rates, ("forward", "backward"), strict=True):
        nanoseconds = 1e9 * median[stage] / (rows * LANES)
        cells += [f"{1e3 * median[stage]:.1f}", f"{nanoseconds:.3f}", f"{rate:.0f}"]
        cells += [f"{100 * rate / peak:.0f} %"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table, and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    parallel.set_threads(1)
    heads = [
        "Gaussians",
        "meetings per pixel",
        "rows per run",
        "meetings that blend",
        "peak, GFLOP/s",
    ]
    for stage in ("forward", "backward"):
        heads += [f"{stage}, ms", "ns per meeting", "GFLOP/s", "of the peak"]
    lines = [f"| {' | '.join(heads)} |", f"|{'---:|' * len(heads)}", *map(row_of, COUNTS)]
    table = "\n".join(lines)
    print(table)
    if options.output is not None:
        head = (
            f"# Fraction of a core's peak\n\n`python benchmarks/speed/peak.py` on {cpu_model()}, "
        )
        head += f"one thread, 504x378, medians of {TURNS + 1} turns.\n\n"
        options.output.write_text(f"{head}{table}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
