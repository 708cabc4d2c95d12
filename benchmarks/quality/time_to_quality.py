"""CPU seconds until a scene is within 0.5, 0.2 and 0.1 dB of a long training, and of the best one.

    python benchmarks/quality/time_to_quality.py --scene "scene=embedded" \\
        --scene "scene=llff scene.path=DIR scene.n_views=3 +augment=safi +reg=uar" \\
        [--steps 50,100,200,300,600,1000] [--reference 10000] [--threads N] [--output FILE.md]

Every number of steps is a training of its own, as the schedules depend on it; seconds are of
depth, initialisation and training with its checkpoints, without evaluation. CPU seconds decide, as
other programs disturb them less than the clock (on a core's second thread they still rise).
Interpolating and extrapolating test views are told apart. Prints markdown, or writes it to FILE.md
with FILE.png beside it; FILE.json keeps what was measured, so that a second call goes on where the
first ended.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import re
import statistics
import sys
import time
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.prepare import configured, prepared
from framework.compute import parallel
from framework.metrics.evaluate import psnr
from framework.metrics.values import Missing
from framework.options import TrainerOptions
from framework.records.provenance import code_hash, cpu_model, strict_json
from framework.report.figures.files import DPI
from framework.report.parts import chart
from framework.report.parts.draw import draw
from framework.run import experiment
from framework.run.plugin_code import plugin_hashes
from framework.run.training import renderer

GAPS_DB = (0.5, 0.2, 0.1)


@dataclass(frozen=True)
class Point:
    """seconds, cpu_seconds: of the training with its start. psnr: mean over the test views. by_tag:
    over those with a tag. worst: view and its PSNR."""

    steps: int
    seconds: float
    cpu_seconds: float
    psnr: float
    by_tag: dict[str, float]
    worst: tuple[str, float]


def measure(scene: str, steps: int) -> Point:
    """Train once, everything but compiling and evaluating on the clock."""
    line = [*scene.split(), f"trainer.steps={steps}"]
    _warm(scene)
    prepared(line)  # the scene; the depth is forgotten, to be on the clock
    experiment._depth.cache_clear()
    start, cpu_start = time.perf_counter(), time.process_time()
    run = prepared(line)
    trained = run.trained()
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
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
    return Point(steps, seconds, cpu_seconds, mean, by_tag, (worst, values[worst]))


@functools.cache
def _warm(scene: str) -> None:
    """Load all kernels."""
    prepared([*scene.split(), "trainer.steps=10"]).trained()


def rows(points: list[Point]) -> list[str]:
    """A row per training; then when the gaps to the best and to the longest are closed."""
    lines = [
        f"| {p.steps} | {p.seconds:.1f} | {p.cpu_seconds:.1f} | {p.psnr:.2f} | "
        + ", ".join(f"{tag} {value:.2f}" for tag, value in sorted(p.by_tag.items()))
        + f" | {p.worst[0]} {p.worst[1]:.2f} |"
        for p in points
    ]
    last, best = points[-1], max(points, key=lambda point: point.psnr)
    lines += [
        "",
        f"The best is {best.psnr:.2f} dB with {best.steps} steps: {_reached(points, best)}. The"
        f" longest: {_reached(points, last)}.",
    ]
    return lines


def _reached(points: list[Point], goal: Point) -> str:
    told = []
    for gap in GAPS_DB:
        good = [p.cpu_seconds for p in points if p.psnr >= goal.psnr - gap]
        told.append(f"{gap} dB after {min(good):.0f} CPU s")
    return f"within {', '.join(told)}"


def charts(measured: dict[str, list[Point]]) -> list[chart.Chart]:
    """PSNR beside the best training's: of all test views and of those with either tag."""
    tags = sorted({tag for points in measured.values() for tag in points[-1].by_tag})
    made = []
    for tag in (None, *tags):
        series = []
        for index, (name, points) in enumerate(measured.items()):
            values = [p.psnr if tag is None else p.by_tag.get(tag) for p in points]
            known = [value for value in values if value is not None]
            if not known:
                continue
            lost = [value - max(known) for value in known]
            pairs = zip(points, lost, strict=True)
            dots = tuple(chart.Point(p.cpu_seconds, loss, loss, loss) for p, loss in pairs)
            series.append(chart.Series(name, index, dots))
        views = "all test views" if tag is None else f"{tag} test views"
        title = f"Beside the best training, {views}"
        label = "PSNR beside it (dB)"
        x_label = "CPU seconds of depth, initialisation and training"
        own = chart.Chart("", title, x_label, label, tuple(series), log_x=True, y_zero=True)
        made.append(own)
    return made


def identity(scene: str) -> str:
    """Of code and configuration, with the scene's folder: what a measurement holds for."""
    config = configured(scene.split())
    text = code_hash() + strict_json([config, plugin_hashes(config)])
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def short(scene: str) -> str:
    """A legend's name: the folder of the scene, or its layout, the number of views, the rest."""
    folder = re.search(r"path=\S*?([^/\s]+)/?(?:\s|$)", scene)
    layout = re.search(r"scene=(\S+)", scene)
    views = re.search(r"n_views=(\d+)", scene)
    name = folder[1] if folder else layout[1] if layout else scene
    shown = ("scene=", "scene.path=", "scene.n_views=")
    rest = [word for word in scene.split() if not word.startswith(shown)]
    return " ".join([f"{name}, {views[1]} views" if views else name, *rest])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", action="append", required=True)
    parser.add_argument("--steps", default="50,100,200,300,600,1000")
    parser.add_argument("--reference", type=int, default=10000)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    parallel.set_threads(given.threads)
    kept = given.output.with_suffix(".json") if given.output else None
    known = json.loads(kept.read_text()) if kept and kept.exists() else {}
    steps = [*map(int, given.steps.split(",")), given.reference]
    measured: dict[str, list[Point]] = {}
    lines = [
        "# Time to quality",
        "",
        f"`python benchmarks/quality/time_to_quality.py --steps {given.steps}"
        f" --reference {given.reference}` with the headings below as `--scene`,"
        f" on {cpu_model()}, {parallel.threads()} threads.",
    ]
    for scene in given.scene:
        name, points = re.sub(r"path=\S+", "path=DIR", scene), []
        for count in steps:
            key = f"{name}, {count} steps, {parallel.threads()} threads, {identity(scene)}"
            if key not in known:
                known[key] = asdict(measure(scene, count))
                if kept:
                    kept.write_text(json.dumps(known, indent=1) + "\n")
            points.append(Point(**known[key]))
            print(key, points[-1], file=sys.stderr, flush=True)
        measured[short(scene)] = points
        lines += ["", f"## {short(scene)}: `{name}`", ""]
        lines += ["| steps | seconds | CPU s | test PSNR | by kind | worst view |"]
        lines += ["|---:|---:|---:|---:|---|---|", *rows(points)]
    text = "\n".join(lines) + "\n"
    print(text)
    if given.output:
        picture = given.output.with_suffix(".png")
        draw(charts(measured)).savefig(picture, dpi=DPI, metadata={"Software": None})
        title, rest = text.split("\n", 1)
        given.output.write_text(f"{title}\n\n![PSNR against time]({picture.name})\n{rest}")


if __name__ == "__main__":
    main()
