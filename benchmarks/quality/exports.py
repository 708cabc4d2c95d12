"""What a run's Gaussians lose in exported files.

    python benchmarks/quality/exports.py RUN [RUN ...] --transform PATH/TO/splat-transform \\
        --output benchmarks/results/exports.md
    python benchmarks/quality/exports.py RUN [RUN ...] --compact

Each RUN (the folder of a finished run with test views) is exported in every format, in the frame of
its cameras. Two independent programs read the files: PlayCanvas' splat-transform (npm,
@playcanvas/splat-transform), which converts them to PLY, and gsply (Python). Our rasterizer renders
the result from the test cameras. PSNR is measured against the test photos and against our own
renders of the run, which isolates the loss of the file. splat-transform undoes the rotation of
SPZ's axes; gsply does not, so it is undone here.

With --compact it prints instead what `fishersplat export --compact` saves and loses, in the frame
of the cameras, read by our own reader.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.exports.compact import Photo, compact, decoded, mean_psnr, read_photos
from framework.exports.export import NAME
from framework.exports.export import main as export
from framework.exports.formats import SUFFIXES, TURNED, packed
from framework.exports.opened import OpenedRun, open_run
from framework.exports.upright import moved_gaussians
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.metrics.evaluate import psnr
from framework.types import Gaussians

HEADER = (
    "| scene | Gaussians, SH degree | format | size | of the PLY | read by | read"
    " | PSNR, test photos | PSNR, our renders |\n|---|---|---|---:|---:|---|---:|---:|---:|\n"
)
GSPLY = ("ply", "compressed-ply", "spz")  # what it reads as well
OPAQUE = 16.0  # the logit of an opacity that a byte rounds to 1
COMPACT_HEADER = (
    "| run | Gaussians, SH degree | SPZ | compact | of SPZ | bytes of a Gaussian | SH degree, bits"
    " | coordinates | PSNR, stored | SPZ | compact | training photos, compact |\n"
    "|---|---|---:|---:|---:|---:|---|---:|---:|---:|---:|---:|\n"
)


def of_gsply(data: Any) -> Gaussians:
    """What gsply read as ours. An opacity of 1 has no logit: it is given a large one."""

    def tensor(values: Any, *shape: int) -> torch.Tensor:
        return torch.from_numpy(np.array(values, dtype=np.float32)).reshape(shape)

    n = len(data.means)
    has_bands = data.shN is not None and np.size(data.shN) > 0
    return Gaussians(
        means=tensor(data.means, n, 3),
        quats=tensor(data.quats, n, 4),
        log_scales=tensor(data.scales, n, 3),
        opacity_logits=tensor(data.opacities, n).nan_to_num(posinf=OPAQUE).clamp(-OPAQUE, OPAQUE),
        sh0=tensor(data.sh0, n, 1, 3),
        shN=tensor(data.shN, n, -1, 3) if has_bands else torch.zeros(n, 0, 3),
    )


def readers(kind: str, transform: str) -> Iterator[tuple[str, Callable[[Path], Gaussians]]]:
    """Who reads files of a kind."""
    import gsply

    def by_transform(file: Path) -> Gaussians:
        back = file.parent / "back.ply"
        line = [transform, "-q", "-w", str(file), str(back)]
        subprocess.run(line, check=True, capture_output=True)
        return of_gsply(gsply.plyread(back))

    def by_gsply(file: Path) -> Gaussians:
        if kind == "spz":
            return moved_gaussians(of_gsply(gsply.read_spz(file)), TURNED)
        return of_gsply(gsply.plyread(file))

    yield "splat-transform", by_transform
    if kind in GSPLY:
        yield "gsply", by_gsply


def rows(run: Path, transform: str, folder: Path) -> Iterator[str]:
    """The table's rows of a run."""
    opened, (_, photos) = open_run(run), read_photos(run)
    renders = [opened.render(photo.camera).rgb for photo in photos]
    export([str(run), "--format", "all", "--frame", "scene", "--out", str(folder)], "export")
    whole = (folder / f"{NAME}.ply").stat().st_size
    title = read_json(run / "record.json", TEXT_BYTES)["scene"]["name"]
    model = f"{len(opened.gaussians):,}, {opened.gaussians.sh_degree}"
    for kind, suffix in SUFFIXES.items():
        file = folder / f"{NAME}{suffix}"
        size = file.stat().st_size
        for reader, read in readers(kind, transform):
            gaussians = read(file)
            seen = OpenedRun(run, gaussians, opened.background, opened.cameras, opened.near)
            drawn = [seen.render(photo.camera).rgb for photo in photos]
            cells = [title, model, kind, f"{size / 1e6:.2f} MB", f"{100 * size / whole:.0f} %"]
            cells += [reader, f"{len(gaussians):,}"]
            cells += [f"{mean_psnr(opened, gaussians, photos):.2f} dB", mean(drawn, renders)]
            yield f"| {' | '.join(cells)} |\n"


def compact_row(run: Path) -> str:
    """A run's row of the table of compact files."""
    opened, (train, test) = open_run(run), read_photos(run)
    spz = packed(opened.gaussians, opened.background, "spz")
    result = compact(opened, train)

    def loss(gaussians: Gaussians, photos: Sequence[Photo]) -> str:
        before = mean_psnr(opened, opened.gaussians, photos)
        return f"{mean_psnr(opened, gaussians, photos) - before:+.3f}"

    n, small, precision = len(opened.gaussians), len(result.content), result.precision
    cells = [
        f"{run.parent.parent.name}",
        f"{n:,}, {opened.gaussians.sh_degree}",
        f"{len(spz) / 1e3:.0f} kB",
        f"{small / 1e3:.0f} kB",
        f"{100 * small / len(spz):.0f} %",
        f"{small / n:.1f}",
        f"{precision.degree}, {precision.bits}" if precision.degree else "0",
        f"1/{2**precision.fraction}",
        f"{mean_psnr(opened, opened.gaussians, test):.2f} dB",
        loss(decoded(spz), test),
        loss(result.gaussians, test),
        loss(result.gaussians, train),
    ]
    return f"| {' | '.join(cells)} |\n"


def mean(drawn: list[torch.Tensor], truth: list[torch.Tensor]) -> str:
    """Mean PSNR."""
    values = [psnr(one, other) for one, other in zip(drawn, truth, strict=True)]
    numbers = [value for value in values if isinstance(value, float)]
    return f"{np.mean(numbers):.2f} dB" if len(numbers) == len(values) else "equal"


def version(program: str) -> str:
    """Its name and version, which it prints to one of its streams or the other."""
    process = subprocess.run([program, "-v"], capture_output=True, text=True, check=True)
    lines = (process.stdout + process.stderr).strip().splitlines()
    if not lines:
        sys.exit(f"{program} -v: expected its version, got nothing")
    return lines[-1].strip()


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--transform", default="splat-transform", metavar="PROGRAM")
    parser.add_argument("--output", type=Path)
    parser.add_argument("--compact", action="store_true", help="measure compact files")
    options = parser.parse_args()
    if options.compact:
        print(COMPACT_HEADER, *map(compact_row, options.runs), sep="", end="")
        return
    reader = version(options.transform)
    text = ""
    for run in options.runs:
        with tempfile.TemporaryDirectory() as folder:
            for row in rows(run, options.transform, Path(folder)):
                print(row, end="", flush=True)
                text += row
    line = shlex.join(["python", "benchmarks/quality/exports.py", *map(str, options.runs)])
    said = f"`{line}`, read by {reader} and gsply"
    said += f" {metadata.version('gsply')}.\n\n"
    if options.output is not None:
        options.output.write_text(f"# Files of other programs\n\n{said}{HEADER}{text}", "utf-8")


if __name__ == "__main__":
    main()
