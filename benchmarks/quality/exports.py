"""What a run's Gaussians lose in exported files.

    python benchmarks/quality/exports.py RUN [RUN ...] --transform PATH/TO/splat-transform \\
        --output benchmarks/results/exports.md

Each RUN (the folder of a finished run with test views) is exported in every format, in the frame of
its cameras. Two independent programs read the files: PlayCanvas' splat-transform (npm,
@playcanvas/splat-transform), which converts them to PLY, and gsply (Python). Our rasterizer renders
the result from the test cameras. PSNR is measured against the test photos and against our own
renders of the run, which isolates the loss of the file. splat-transform undoes the rotation of
SPZ's axes; gsply does not, so it is undone here.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.exports.export import NAME
from framework.exports.export import main as export
from framework.exports.formats import SUFFIXES, TURNED
from framework.exports.opened import OpenedRun, open_run, read_named_cameras
from framework.exports.upright import moved_gaussians
from framework.files.documents import read_json
from framework.files.limits import TEXT_BYTES
from framework.metrics.evaluate import psnr
from framework.records.run_files import RENDERS, file_stems
from framework.types import Camera, Gaussians

HEADER = (
    "| scene | Gaussians, SH degree | format | size | of the PLY | read by | read"
    " | PSNR, test photos | PSNR, our renders |\n|---|---|---|---:|---:|---|---:|---:|---:|\n"
)
GSPLY = ("ply", "compressed-ply", "spz")  # what it reads as well
OPAQUE = 16.0  # the logit of an opacity that a byte rounds to 1
Test = list[tuple[Camera, torch.Tensor, torch.Tensor | None]]  # with its photo [3, H, W] and mask


def test_views(run: Path) -> Test:
    """The run's test cameras and photos."""
    test_names = read_json(run / "transforms.json", TEXT_BYTES)["test_filenames"]
    cameras = {entry.name: entry.camera for entry in read_named_cameras(run / "transforms.json")}
    views = []
    for name, stem in zip(test_names, file_stems(test_names), strict=True):
        photo = pixels(run / RENDERS / f"{stem}_truth.png", "RGB").permute(2, 0, 1)
        mask = run / RENDERS / f"{stem}_mask.png"
        views.append((cameras[name], photo, pixels(mask, "L") if mask.is_file() else None))
    return views


def pixels(file: Path, mode: str) -> torch.Tensor:
    """In [0, 1]."""
    with Image.open(file) as image:
        return torch.from_numpy(np.array(image.convert(mode), dtype=np.float32) / 255)


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
    opened, views = open_run(run), test_views(run)
    renders = [opened.render(camera).rgb for camera, _, _ in views]
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
            drawn = [seen.render(camera).rgb for camera, _, _ in views]
            cells = [title, model, kind, f"{size / 1e6:.2f} MB", f"{100 * size / whole:.0f} %"]
            cells += [reader, f"{len(gaussians):,}"]
            cells += [mean(drawn, [(photo, mask) for _, photo, mask in views])]
            yield f"| {' | '.join([*cells, mean(drawn, [(one, None) for one in renders])])} |\n"


def mean(drawn: list[torch.Tensor], truth: list[tuple[torch.Tensor, torch.Tensor | None]]) -> str:
    """Mean PSNR, within the masks."""
    values = [psnr(one, *other) for one, other in zip(drawn, truth, strict=True)]
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
    options = parser.parse_args()
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
