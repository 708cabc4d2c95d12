"""Reads a run's folder for the page: record, Gaussians, cameras, paths of photos."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from framework.errors import UserError, require
from framework.exports.opened import NamedCamera, read_run_cameras
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.records import RUN_FOLDERS
from framework.records.ply import Splats, read_splats
from framework.records.record import PLY, RECORD, RunRecord, read_run
from framework.records.run_files import RENDERS, photo_files
from framework.records.spz_reader import read_spz

FEW = 6  # runs that a message names
USUAL = "reports/STUDY/runs/RUN"
SAME = 1e-4  # of the rig's size, and of an axis: largest difference of a camera in two runs


@dataclass(frozen=True)
class ViewedRun:
    """What the page shows of a run.

    Attributes:
        near: depth where rendering begins.
        photos: view -> file of its photo, if the run kept it.
        psnr: test view -> dB, None if it is infinite.
    """

    folder: Path
    record: RunRecord
    splats: Splats
    cameras: tuple[NamedCamera, ...]
    near: float
    photos: Mapping[str, Path]
    psnr: Mapping[str, float | None]

    @property
    def scene(self) -> str:
        """The scene's name."""
        return self.record.scene.name if self.record.scene else "scene"


def find_run(path: Path) -> Path:
    """The folder of a run: `path`, or the only run of the study there.

    Raises:
        UserError: if there is none, or more than one.
    """
    if is_file(path / RECORD):
        return path
    require(
        path.is_dir(),
        f"{path}: expected the folder of a run, found {'a file' if path.exists() else 'nothing'};"
        f" it is the one that holds {RECORD}, as {USUAL}",
    )
    runs = sorted(run for run in path.glob(f"{RUN_FOLDERS}/*") if is_file(run / RECORD))
    names = ", ".join(str(run) for run in runs[:FEW]) + (" ..." if len(runs) > FEW else "")
    got = (
        f"{len(runs)} runs; name one: {names}"
        if runs
        else f"neither {RECORD} nor runs; name one as {USUAL}"
    )
    require(len(runs) == 1, f"{path}: expected the folder of a run, got one with {got}")
    return runs[0]


def read_viewed(folder: Path) -> ViewedRun:
    """Read a run.

    Raises:
        UserError: for a failed run or damaged files.
    """
    run = read_run(folder)
    record = run.record
    require(
        record.status == "complete",
        f"{folder}: expected a complete run, got one that failed"
        f" ({record.error or 'no reason given'}); run it again",
    )
    splats = read_splats(inside(folder, PLY))
    read = read_run_cameras(folder)
    texts, values = run.metrics.texts, run.metrics.numbers["psnr"]
    files = {
        v: f"{RENDERS}/{s}_truth.png" for v, s in zip(texts["view"], texts["file"], strict=True)
    }
    training = record.scene.training if record.scene else ()
    files |= dict(zip(training, photo_files(training), strict=True))
    photos = {view: inside(folder, name) for view, name in files.items() if is_file(folder / name)}
    psnr = {
        view: float(value) if math.isfinite(value) else None
        for view, value in zip(texts["view"], values, strict=True)
    }
    return ViewedRun(folder, record, splats, read.cameras, read.near, photos, psnr)


def read_exported(file: Path) -> ViewedRun:
    """Read an SPZ file in the export folder of a run, with the cameras of that export.

    The test PSNR of the run is left out, as it is not that of the file.

    Raises:
        UserError: as `read_viewed`, and for a damaged file or one of no run.
    """
    folder = file.absolute().parent
    require(
        is_file(folder.parent / RECORD),
        f"{file}: expected a file that fishersplat export wrote to the folder of a run, got one"
        f" without {RECORD} in {folder.parent}",
    )
    run = read_viewed(folder.parent)
    splats = replace(read_spz(file), background=run.splats.background)
    read = read_run_cameras(folder)
    record = replace(run.record, summary={})
    return ViewedRun(folder, record, splats, read.cameras, read.near, run.photos, {})


def check_together(runs: Sequence[ViewedRun]) -> None:
    """Raise UserError unless the runs are of one scene, with equal cameras."""
    first = runs[0]
    named = {camera.name: camera for camera in first.cameras}
    for other in runs[1:]:
        where = f"{other.folder}: expected a run of the same scene as {first.folder}"
        common = [(named[c.name], c) for c in other.cameras if c.name in named]
        if not common:
            raise UserError(f"{where}, got no camera of the same name; choose two of one scene")
        apart = _apart(common)
        require(
            apart <= SAME,
            f"{where}, got cameras in other places (off by {apart:.2g} of the rig's size);"
            " choose two runs with the same poses",
        )


def _apart(pairs: Sequence[tuple[NamedCamera, NamedCamera]]) -> float:
    """The largest difference of the cameras: of the rig's size, or of an axis."""
    centers = np.array([one.center for one, _ in pairs])
    size = max(float(np.ptp(centers, axis=0).max()), 1e-3 * float(np.abs(centers).max()), 1e-9)
    moved = max(float(np.abs(one.center - other.center).max()) for one, other in pairs)
    turned = (one.viewmat[:3, :3] - other.viewmat[:3, :3] for one, other in pairs)
    return max(moved / size, *(float(np.abs(axes).max()) for axes in turned))
