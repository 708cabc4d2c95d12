"""How accurately `scene=photos` estimates camera poses that are known.

    python benchmarks/quality/photos.py --output benchmarks/results/photos.md \\
        fern=DIR:8 fern=DIR:20 door=DIR --train preset=fast

Each DIR is a COLMAP scene (`images`, `sparse/0`). The given number of its photos, evenly spread, is
copied to a new folder without poses. DIR+DIR takes the photos of both.
Errors are those of the camera's direction and position after the best similarity (rotation: mean of
the relative ones; scale and shift: least squares). Positions are in percent of the largest distance
from the mean camera. Seconds are CPU time of all threads.

With --train each scene is also trained, once from the photos alone and once from the known poses,
on the same split. A second table lists the seconds of the first training by stage. Its last stage,
rest, is start-up, reading photos, writing files and the report.
"""

from __future__ import annotations

import argparse
import json
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.errors import UserError
from framework.records.provenance import cpu_model
from framework.scenes.colmap_model import read_model
from framework.scenes.photos.advice import advice
from framework.scenes.photos.process import poses_folder
from framework.scenes.photos.result import Result, read_result
from framework.scenes.photos.source import find_source

ROOT = Path(__file__).resolve().parents[2]
HEADER = (
    "| photos | placed | tries | rotation, median / worst | place, median / worst | focal length"
    " | PSNR, found poses | PSNR, given poses |\n|---|---:|---:|---:|---:|---:|---:|---:|\n"
)
SEARCH = ("features", "matching", "mapping")  # stages of the search for poses
RUN = ("depth", "init", "train", "evaluate")  # and of the run
SECONDS = (
    f"| photos | {' | '.join((*SEARCH, *RUN))} | rest | all | on the clock |\n|---|"
    + "---:|" * (len(SEARCH) + len(RUN) + 3)
    + "\n"
)
Cameras = dict[str, tuple[NDArray[np.float64], float]]  # name -> world-to-camera, focal length


@dataclass(frozen=True)
class Errors:
    """degrees, and percent of the rig; focal: mean ratio found to known, minus 1, in percent."""

    degrees: NDArray[np.float64]
    percent: NDArray[np.float64]
    focal: float


def cameras(sparse: Path) -> Cameras:
    """The cameras of a COLMAP model."""
    model = read_model(sparse)
    rows = zip(model.names, model.viewmats, model.lenses, strict=True)
    return {name: (view, lens.fx / lens.width) for name, view, lens in rows}


def errors(estimated: Cameras, reference: Cameras) -> Errors:
    """Return the errors of the estimated cameras after the best similarity transform."""
    names = sorted(estimated)
    ours = np.array([estimated[name][0] for name in names])
    theirs = np.array([reference[name][0] for name in names])
    relative = np.einsum("nji,njk->ik", theirs[:, :3, :3], ours[:, :3, :3])
    u, _, vt = np.linalg.svd(relative)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt  # our world to theirs
    left = np.einsum("nij,kj,nlk->nil", ours[:, :3, :3], turn, theirs[:, :3, :3])
    cosine = (np.trace(left, axis1=1, axis2=2) - 1) / 2
    a, b = _centers(ours) @ turn.T, _centers(theirs)
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = float((a * b).sum() / (a * a).sum())
    size = np.linalg.norm(b, axis=1).max()
    focal = np.mean([estimated[name][1] / reference[name][1] for name in names]) - 1
    return Errors(
        np.degrees(np.arccos(np.clip(cosine, -1, 1))),
        100 * np.linalg.norm(scale * a - b, axis=1) / size,
        100 * float(focal),
    )


def _centers(views: NDArray[np.float64]) -> NDArray[np.float64]:
    centers: NDArray[np.float64] = -np.einsum("nji,nj->ni", views[:, :3, :3], views[:, :3, 3])
    return centers


def copied(scenes: list[Path], count: int | None, folder: Path) -> list[str]:
    """Copy `count` photos of each scene; returns the names."""
    names = []
    for k, scene in enumerate(scenes):
        files = sorted(f for f in (scene / "images").iterdir() if f.suffix != ".md")
        chosen = np.linspace(0, len(files) - 1, count or len(files)).round().astype(int)
        for i in chosen:
            name = files[i].name if len(scenes) == 1 else f"{k}-{files[i].name}"
            shutil.copyfile(files[i], folder / name)
            names.append(name)
    return names


def known_scene(scene: Path, names: set[str], folder: Path) -> None:
    """A COLMAP scene of the photos `names` alone, with the known poses."""
    import pycolmap

    (folder / "images").mkdir(parents=True)
    model = pycolmap.Reconstruction(str(scene / "sparse" / "0"))
    for image in list(model.images.values()):
        if image.name in names:
            shutil.copyfile(scene / "images" / image.name, folder / "images" / image.name)
            continue
        for index, point in enumerate(image.points2D):
            if point.has_point3D():
                model.delete_observation(image.image_id, index)
        model.deregister_frame(image.frame_id)
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    model.write_binary(str(sparse))


@dataclass(frozen=True)
class Trained:
    """A run: its test PSNR, or its error; CPU seconds by stage; those of the whole command, with
    all its processes; and its seconds on the clock."""

    psnr: str
    stages: dict[str, float]
    cpu_s: float
    wall_s: float


def trained(scene: list[str], overrides: list[str], out: Path) -> Trained:
    """One command from photos to Gaussians."""
    line = [sys.executable, "run.py", *scene, *overrides, f"hydra.run.dir={out}"]
    before, started = children_s(), time.monotonic()
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    cpu_s, wall_s = children_s() - before, time.monotonic() - started
    if done.returncode:
        return Trained(done.stderr.strip().splitlines()[-1], {}, cpu_s, wall_s)
    record: dict[str, Any] = json.loads((out / "record.json").read_text())
    stages = {stage["stage"]: stage["cpu_s"] for stage in record["timings"]}
    return Trained(f"{record['summary']['psnr']['mean']:.2f} dB", stages, cpu_s, wall_s)


def children_s() -> float:
    """CPU seconds of all processes that this one has waited for, and those that they have."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@dataclass(frozen=True)
class Measured:
    """A row of each table, and remarks below them."""

    row: str
    seconds: str = ""
    remarks: tuple[str, ...] = ()


def measured(entry: str, overrides: list[str], work: Path) -> Measured:
    """The rows of `title=DIR[+DIR][:count]`; overrides: of the trainings, none for no training."""
    title, _, rest = entry.partition("=")
    paths, _, count = rest.partition(":")
    scenes = [Path(path) for path in paths.split("+")]
    folder = work / "photos"
    folder.mkdir()
    names = copied(scenes, int(count) if count else None, folder)
    title = f"{title}, {len(names)}"
    photos = ["scene=photos", f"scene.path={folder}"]
    ours = trained(photos, overrides, work / "ours") if overrides else None  # finds the poses too
    try:
        poses = poses_folder(find_source(str(folder), side=1200, frames=40))
    except UserError as error:
        remark = f"{title}: {error}".replace(str(folder), "DIR")
        return Measured(f"| {title} | 0 of {len(names)} | | | | | | |\n", remarks=(remark,))
    result = read_result(poses)
    remarks = (f"{title}: left out {', '.join(result.left_out)}",) if result.left_out else ()
    if result.groups:
        remarks += tuple(f"{title}: {line}" for line in advice(result))
    theirs, cells = None, ["", "", ""]
    if len(scenes) == 1 and (scenes[0] / "sparse" / "0").is_dir():
        wrong = errors(cameras(poses / "sparse" / "0"), cameras(scenes[0] / "sparse" / "0"))
        spread = [(np.median(v), v.max()) for v in (wrong.degrees, wrong.percent)]
        cells = [f"{spread[0][0]:.2f}° / {spread[0][1]:.2f}°"]
        cells += [f"{spread[1][0]:.2f} % / {spread[1][1]:.2f} %", f"{wrong.focal:+.1f} %"]
        if overrides:
            known_scene(scenes[0], set(result.placed), work / "known")
            reference = ["scene=colmap", f"scene.path={work / 'known'}", "scene.n_views=all"]
            theirs = trained(reference, overrides, work / "theirs")
    cells += ["" if run is None else run.psnr for run in (ours, theirs)]
    placed = f"{len(result.placed)} of {len(result.photos)}"
    row = f"| {' | '.join([title, placed, str(len(result.tries)), *cells])} |\n"
    return Measured(row, seconds_row(title, result, ours), remarks)


def seconds_row(title: str, result: Result, run: Trained | None) -> str:
    """CPU seconds by stage; without a training only those of the search."""
    spent = [sum(getattr(t, f"{name}_cpu_s") for t in result.tries) for name in SEARCH]
    cells = [f"{s:.1f} s" for s in spent]
    if run is None:
        return f"| {' | '.join([title, *cells])} |{' |' * (len(RUN) + 3)}\n"
    spent += [run.stages.get(name, 0.0) for name in RUN]
    cells = [f"{s:.1f} s" for s in (*spent, run.cpu_s - sum(spent), run.cpu_s)]
    return f"| {' | '.join([title, *cells, f'{run.wall_s:.0f} s'])} |\n"


def main() -> None:
    """Print the tables, or write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scenes", nargs="+", metavar="NAME=DIR[+DIR][:COUNT]")
    parser.add_argument("--train", default="", metavar="OVERRIDES")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    done = []
    for entry in options.scenes:
        with tempfile.TemporaryDirectory() as work:
            done.append(measured(entry, options.train.split(), Path(work)))
        print(done[-1].row, done[-1].seconds, *done[-1].remarks, flush=True)
    said = "".join(f"- {' '.join(remark.split())}\n" for one in done for remark in one.remarks)
    line = f"`{shlex.join(['python', 'benchmarks/quality/photos.py', *sys.argv[1:]])}`"
    text = f"{line}\n\nOn {cpu_model()}.\n\n{HEADER}{''.join(one.row for one in done)}\n{said}"
    text += f"\nCPU seconds of the run with found poses:\n\n{SECONDS}"
    text += "".join(one.seconds for one in done)
    if options.output is not None:
        options.output.write_text(f"# Poses of photos\n\n{text}", encoding="utf-8")


if __name__ == "__main__":
    main()
