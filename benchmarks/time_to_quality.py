"""Seconds until a scene is within 0.5, 0.2 and 0.1 dB of a long training.

    python benchmarks/time_to_quality.py --scene "scene=embedded" \\
        --scene "scene=llff scene.path=DIR scene.n_views=3 +augment=safi +reg=uar" \\
        [--steps 50,100,200,300,600,1000] [--reference 10000] [--threads N] [--output FILE]

Every number of steps is a training of its own, as the schedules depend on it; seconds are wall time
of depth, initialisation and training, without evaluation. Test views tagged `interpolating` or
`extrapolating` are told apart. Writes a markdown table to FILE, or prints it.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.prepare import prepared
from framework import experiment, parallel
from framework.metrics import Missing, psnr
from framework.options import TrainerOptions
from framework.provenance import cpu_model
from framework.training import renderer

GAPS_DB = (0.5, 0.2, 0.1)


@dataclass(frozen=True)
class Point:
    """psnr: mean over the test views. by_tag: over those with a tag. worst: view and its PSNR."""

    steps: int
    seconds: float
    psnr: float
    by_tag: dict[str, float]
    worst: tuple[str, float]


def measure(scene: str, steps: int) -> Point:
    """Train once, everything but compiling and evaluating on the clock."""
    line = [*scene.split(), f"trainer.steps={steps}"]
    prepared(line)  # kernels and scene; the depth is forgotten, to be on the clock
    experiment._depth.cache_clear()
    start = time.perf_counter()
    run = prepared(line)
    trained = run.trainer().run()
    seconds = time.perf_counter() - start
    options, near = TrainerOptions(**run.config["trainer"]), run.scene.training.near
    render = renderer(
        trained.gaussians, trained.background, trained.sh_degree, options.near_plane * near
    )
    values, tagged = {}, defaultdict(list)
    for view in run.scene.test:
        value = psnr(render(view.camera), view.image, view.mask)
        if not isinstance(value, Missing):
            values[view.name] = value
            for tag in view.tags:
                tagged[tag].append(value)
    worst = min(values, key=lambda name: values[name])
    by_tag = {tag: statistics.fmean(own) for tag, own in tagged.items()}
    mean = statistics.fmean(values.values())
    return Point(steps, seconds, mean, by_tag, (worst, values[worst]))


def rows(points: list[Point]) -> list[str]:
    """A row per training; then when the gaps to the last, longest one are closed."""
    lines = [
        f"| {point.steps} | {point.seconds:.1f} | {point.psnr:.2f} | "
        + ", ".join(f"{tag} {value:.2f}" for tag, value in sorted(point.by_tag.items()))
        + f" | {point.worst[0]} {point.worst[1]:.2f} |"
        for point in points
    ]
    reached = []
    for gap in GAPS_DB:
        good = [p.seconds for p in points if p.psnr >= points[-1].psnr - gap]
        reached.append(f"{gap} dB after {min(good):.0f} s")
    best = max(points, key=lambda point: point.psnr)
    lines += [
        "",
        f"Within {', '.join(reached)} of {points[-1].steps} steps; best {best.psnr:.2f} dB"
        f" with {best.steps} steps.",
    ]
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", action="append", required=True)
    parser.add_argument("--steps", default="50,100,200,300,600,1000")
    parser.add_argument("--reference", type=int, default=10000)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    parallel.set_threads(given.threads)
    lines = [
        "# Time to quality",
        "",
        f"`python benchmarks/time_to_quality.py --steps {given.steps}"
        f" --reference {given.reference}` with the headings below as `--scene`,"
        f" on {cpu_model()}, {parallel.threads()} threads.",
    ]
    for scene in given.scene:
        name = re.sub(r"path=\S+", "path=DIR", scene)
        lines += ["", f"## {name}", "", "| steps | seconds | test PSNR | by kind | worst view |"]
        lines += ["|---:|---:|---:|---|---|"]
        steps = [*map(int, given.steps.split(",")), given.reference]
        lines += rows([measure(scene, count) for count in steps])
    text = "\n".join(lines) + "\n"
    print(text)
    if given.output:
        given.output.write_text(text)


if __name__ == "__main__":
    main()
