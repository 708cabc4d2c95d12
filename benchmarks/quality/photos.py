"""How well `scene=photos` finds the poses of photos whose poses are known.

    python benchmarks/quality/photos.py --output benchmarks/results/photos.md \\
        fern=DIR:8 fern=DIR:20 door=DIR [--train preset=fast]

Each DIR is a COLMAP scene (`images`, `sparse/0`), of which the given number of photos, evenly
spread, all without a number, is copied to a new folder: names and pixels, no poses. DIR+DIR takes
the photos of both. Errors are those of the camera's direction and place after the best similarity
(rotation: mean of the relative ones; scale and shift: least squares); places in percent of the
largest distance from the cameras' mean. Seconds are CPU time, all threads together. With --train
each scene is also trained, with the found and with the known poses of the same photos, on the same
split.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from framework.errors import UserError
from framework.records.provenance import cpu_model
from framework.scenes.colmap_model import read_model
from framework.scenes.photos.cached import poses_folder
from framework.scenes.photos.found import Found, read_found
from framework.scenes.photos.source import find_source

ROOT = Path(__file__).resolve().parents[2]
HEADER = (
    "| photos | placed | tries | features | matching | placing | rotation, median / worst"
    " | place, median / worst | focal length |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|\n"
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


def errors(found: Cameras, known: Cameras) -> Errors:
    """Of the found cameras, after the best similarity to the known ones."""
    names = sorted(found)
    ours = np.array([found[name][0] for name in names])
    theirs = np.array([known[name][0] for name in names])
    relative = np.einsum("nji,njk->ik", theirs[:, :3, :3], ours[:, :3, :3])
    u, _, vt = np.linalg.svd(relative)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt  # our world to theirs
    left = np.einsum("nij,kj,nlk->nil", ours[:, :3, :3], turn, theirs[:, :3, :3])
    cosine = (np.trace(left, axis1=1, axis2=2) - 1) / 2
    a, b = _centers(ours) @ turn.T, _centers(theirs)
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    scale = float((a * b).sum() / (a * a).sum())
    size = np.linalg.norm(b, axis=1).max()
    focal = np.mean([found[name][1] / known[name][1] for name in names]) - 1
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


def trained(scene: list[str], overrides: list[str], out: Path) -> str:
    """Test PSNR of a run, as its record says it."""
    line = [sys.executable, "run.py", *scene, *overrides, f"hydra.run.dir={out}"]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        return done.stderr.strip().splitlines()[-1]
    summary: dict[str, Any] = json.loads((out / "record.json").read_text())["summary"]
    return f"{summary['psnr']['mean']:.2f} dB"


def row(title: str, found: Found, wrong: Errors | None) -> str:
    """A row of the table."""
    names = ("features", "matching", "mapping")
    stages = [sum(getattr(t, f"{name}_cpu_s") for t in found.tries) for name in names]
    cells = [title, f"{len(found.placed)} of {len(found.photos)}", str(len(found.tries))]
    cells += [f"{seconds:.1f} s" for seconds in stages]
    if wrong is None:
        return f"| {' | '.join(cells)} | | | |\n"
    spread = [(np.median(v), v.max()) for v in (wrong.degrees, wrong.percent)]
    cells += [f"{spread[0][0]:.2f}° / {spread[0][1]:.2f}°"]
    cells += [f"{spread[1][0]:.2f} % / {spread[1][1]:.2f} %", f"{wrong.focal:+.1f} %"]
    return f"| {' | '.join(cells)} |\n"


def measured(entry: str, train: list[list[str]], work: Path) -> tuple[str, list[str]]:
    """The table's row, and remarks, of `title=DIR[+DIR][:count]`."""
    title, _, rest = entry.partition("=")
    paths, _, count = rest.partition(":")
    scenes = [Path(path) for path in paths.split("+")]
    folder = work / "photos"
    folder.mkdir()
    names = copied(scenes, int(count) if count else None, folder)
    title = f"{title}, {len(names)}"
    try:
        poses = poses_folder(find_source(str(folder), side=1200, frames=40))
    except UserError as error:
        return f"| {title} | 0 of {len(names)} | | | | | | | |\n", [
            f"{title}: {error}".replace(str(folder), "DIR")
        ]
    found = read_found(poses)
    known = [s / "sparse" / "0" for s in scenes]
    wrong = None
    if len(scenes) == 1 and known[0].is_dir():
        wrong = errors(cameras(poses / "sparse" / "0"), cameras(known[0]))
    remarks = [f"{title}: left out {', '.join(found.left_out)}"] if found.left_out else []
    for number, overrides in enumerate(train):
        other = work / f"known{number}"
        known_scene(scenes[0], set(found.placed), other)
        views = f"scene.n_views={len(found.placed) - len(range(0, len(found.placed), 8))}"
        ours = trained(["scene=photos", f"scene.path={folder}", views], overrides, work / "ours")
        theirs = trained(["scene=colmap", f"scene.path={other}", views], overrides, work / "theirs")
        remarks.append(f"{title}, {' '.join(overrides)}: found {ours}, known {theirs}")
    return row(title, found, wrong), remarks


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("scenes", nargs="+", metavar="NAME=DIR[+DIR][:COUNT]")
    parser.add_argument("--train", action="append", default=[], metavar="OVERRIDES")
    parser.add_argument("--output", type=Path)
    given = parser.parse_args()
    rows, remarks = [], []
    for entry in given.scenes:
        with tempfile.TemporaryDirectory() as work:
            line, more = measured(entry, [t.split() for t in given.train], Path(work))
        print(line, *more, sep="\n", flush=True)
        rows.append(line)
        remarks += more
    said = "".join(f"- {' '.join(remark.split())}\n" for remark in remarks)
    text = f"On {cpu_model()}.\n\n{HEADER}{''.join(rows)}\n{said}"
    if given.output is not None:
        given.output.write_text(f"# Poses of photos\n\n{text}", encoding="utf-8")


if __name__ == "__main__":
    main()
