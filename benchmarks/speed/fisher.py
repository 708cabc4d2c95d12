"""Cost of one view's Fisher information, compared with a forward and backward pass.

    python benchmarks/speed/fisher.py [--clock wall] [--output FILE]

The scene is `benchmarks.scene`: 504x378, SH degree 3 stored. Render + gradient (`render_gradient`,
pulled back) and `fisher_information` run in turn in one process; the table has the medians
of the stages and of the whole. The default clock is the processor time of the process, which other
programs disturb less than wall time; so it is one thread's work, whatever the threads.
Prints a markdown table, and writes it to FILE.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

ROOT = Path(__file__).resolve().parents[2]
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
STAGES = ("project", "sort", "bin", "blend", "blend_moments", "information")
WARM_UP = 2
TARGET = 1.3


def _works(count: int, degree: int) -> dict[str, Callable[[], None]]:
    """What is compared, by name; all on the same Gaussians and camera."""
    from benchmarks.scene import HEIGHT, WIDTH, layered_scene
    from framework.compute.rng import stream
    from framework.fisher.information import fisher_information
    from framework.kernels import render_gradient

    gaussians, camera = layered_scene(count)
    noise = stream(0, "benchmark-gradient").random((3, HEIGHT, WIDTH), dtype="float32")

    def both_ways() -> None:
        render_gradient(gaussians, camera, lambda rgb: noise, sh_degree=degree).pull_back()

    def fisher() -> None:
        fisher_information(gaussians, camera, sh_degree=degree)

    return {"both": both_ways, "fisher": fisher}


def _timed(function: Callable[..., Any], clock: Callable[[], float], into: list[float]) -> Any:
    def run(*args: Any, **kwargs: Any) -> Any:
        start = clock()
        result = function(*args, **kwargs)
        into.append(1e3 * (clock() - start))
        return result

    return run


def measure(options: argparse.Namespace, degree: int) -> dict[str, float]:
    """Median milliseconds of both works and of the stages of the Fisher pass."""
    from framework.kernels import Workspace

    clock = CLOCKS[options.clock]
    times: dict[str, list[float]] = {name: [] for name in ("both", "fisher", *STAGES)}
    works = {
        name: _timed(work, clock, times[name])
        for name, work in _works(options.count, degree).items()
    }
    for _ in range(WARM_UP):
        works["both"](), works["fisher"]()
    for collected in times.values():
        collected.clear()
    originals = {name: getattr(Workspace, name) for name in STAGES}
    for _ in range(options.rounds):
        works["both"]()
        for name in STAGES:
            setattr(Workspace, name, _timed(originals[name], clock, times[name]))
        works["fisher"]()
        for name in STAGES:
            setattr(Workspace, name, originals[name])
    return {name: statistics.median(collected) for name, collected in times.items()}


def report(options: argparse.Namespace, medians: dict[int, dict[str, float]]) -> str:
    """The markdown that is printed and written."""
    from framework.records.provenance import cpu_model

    header = ["SH degree", *STAGES, "**Fisher pass**", "forward + backward", "**ratio**"]
    lines = [
        "# Fisher information of one view, milliseconds",
        "",
        f"`python benchmarks/speed/fisher.py --clock {options.clock} --rounds {options.rounds}` on"
        f" {cpu_model()}: {options.count} Gaussians at 504x378, {options.threads} thread(s),"
        f" {options.clock} time, medians of {options.rounds} rounds in turn. To meet: ratio <="
        f" {TARGET}.",
        "",
        "| " + " | ".join(header) + " |",
        "|" + "---:|" * len(header),
    ]
    for degree, m in medians.items():
        cells = [f"{m[name]:.1f}" for name in (*STAGES, "fisher", "both")]
        lines.append(
            f"| {degree} | " + " | ".join([*cells, f"{m['fisher'] / m['both']:.2f}"]) + " |"
        )
    return "\n".join([*lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--clock", choices=sorted(CLOCKS), default="cpu")
    parser.add_argument("--count", type=int, default=50_000)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    import torch

    from framework.compute.parallel import set_threads

    set_threads(options.threads)
    torch.set_num_threads(options.threads)
    text = report(options, {degree: measure(options, degree) for degree in (0, 1, 3)})
    print(text)
    if options.output:
        options.output.write_text(text)


if __name__ == "__main__":
    main()
