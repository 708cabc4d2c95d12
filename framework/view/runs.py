"""A run's folder as the page shows it: record, Gaussians, cameras, where its photos are."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from framework.errors import UserError, require
from framework.files.opened import is_file
from framework.files.paths import inside
from framework.records import RUN_FOLDERS
from framework.records.cameras import NEAR, TRANSFORMS
from framework.records.photos import photo_files
from framework.records.ply import Splats, read_splats
from framework.records.record import PLY, RECORD, RunRecord, read_run
from framework.records.run_files import RENDERS
from framework.view.cameras import RunCamera, read_cameras

FEW = 6  # runs that a message names
USUAL = "reports/STUDY/runs/RUN"
SAME = 1e-4  # of the rig's size, and of an axis: how far one camera may lie apart in two runs


@dataclass(frozen=True)
class ViewedRun:
    """near: the depth in front of which nothing is drawn. photos: view -> its file, for those that
    the run has kept. psnr: test view -> dB, None where it is infinite."""

    folder: Path
    record: RunRecord
    splats: Splats
    cameras: tuple[RunCamera, ...]
    near: float
    photos: Mapping[str, Path]
    psnr: Mapping[str, float | None]

    @property
    def scene(self) -> str:
        """The scene's name."""
        return self.record.scene.name if self.record.scene else "scene"


def find_run(path: Path) -> Path:
    """The folder of a run: `path`, or the only run of the study there.

    Raises UserError where there is none or several.
    """
    if is_file(path / RECORD):
        return path
    require(
        path.is_dir(),
        f"{path}: expected the folder of a run, found {'a file' if path.exists() else 'nothing'};"
        f" it is the one that holds {RECORD}, as {USUAL}",
    )
    found = sorted(record.parent for record in path.glob(f"{RUN_FOLDERS}/*/{RECORD}"))
    names = ", ".join(str(run) for run in found[:FEW]) + (" ..." if len(found) > FEW else "")
    got = (
        f"{len(found)} runs; name one: {names}"
        if found
        else f"neither {RECORD} nor runs; name one as {USUAL}"
    )
    require(len(found) == 1, f"{path}: expected the folder of a run, got one with {got}")
    return found[0]


def read_viewed(folder: Path) -> ViewedRun:
    """All that the page needs. Raises UserError for a run that failed, or whose files are not what
    a run writes."""
    run = read_run(folder)
    record = run.record
    require(
        record.status == "complete",
        f"{folder}: expected a complete run, got one that failed"
        f" ({record.error or 'it tells no reason'}); run it again",
    )
    splats = read_splats(inside(folder, PLY))
    cameras: tuple[RunCamera, ...] = ()
    near = NEAR
    if os.path.lexists(folder / TRANSFORMS):  # runs of before have none
        cameras, near = read_cameras(folder)
    texts, values = run.metrics.texts, run.metrics.numbers["psnr"]
    files = {
        v: f"{RENDERS}/{s}_truth.png" for v, s in zip(texts["view"], texts["file"], strict=True)
    }
    training = record.scene.training if record.scene else ()
    files |= dict(zip(training, photo_files(training), strict=True))
    there = {view: inside(folder, name) for view, name in files.items() if is_file(folder / name)}
    psnr = {
        view: float(value) if math.isfinite(value) else None
        for view, value in zip(texts["view"], values, strict=True)
    }
    return ViewedRun(folder, record, splats, cameras, near, there, psnr)


def check_together(runs: Sequence[ViewedRun]) -> None:
    """Raise UserError unless the runs are of one scene: a camera of one sees the same in all."""
    first = runs[0]
    own = {camera.name: camera for camera in first.cameras}
    for other in runs[1:]:
        where = f"{other.folder}: expected a run of the same scene as {first.folder}"
        if not first.cameras or not other.cameras:
            require(
                first.scene == other.scene,
                f"{where}, got {other.scene} beside {first.scene}; choose two of one scene",
            )
            continue
        common = [(own[c.name], c) for c in other.cameras if c.name in own]
        if not common:
            raise UserError(f"{where}, got no camera of the same name; choose two of one scene")
        centers = np.array([a.center for a, _ in common])
        size = max(float(np.ptp(centers, axis=0).max()), 1e-3 * float(np.abs(centers).max()), 1e-9)
        apart = max(
            max(
                float(np.abs(a.center - b.center).max()) / size,
                float(np.abs(a.viewmat[:3, :3] - b.viewmat[:3, :3]).max()),
            )
            for a, b in common
        )
        require(
            apart <= SAME,
            f"{where}, got cameras in other places (off by {apart:.2g} of the rig's size);"
            " choose two runs with the same poses",
        )
