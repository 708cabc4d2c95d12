"""`fishersplat export RUN`: the Gaussians of a finished run as files for other programs, with the
cameras, a first view and the background."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import Arguments, require
from framework.exports.formats import SUFFIXES, can_write, check_writer, packed
from framework.files.whole import make_folder, write_whole

if TYPE_CHECKING:
    from framework.exports.opened import OpenedRun
    from framework.exports.rig import Array
    from framework.types import Camera

NAME = "scene"


def main(arguments: list[str], prog: str) -> int:
    """Exit status 0.

    Raises:
        UserError: for bad input.
    """
    options = _parser(prog).parse_args(arguments)
    require(
        not (options.compact and options.format),
        "--compact: expected no --format, as it writes SPZ; leave one of them out",
    )
    kinds = [] if options.compact else _kinds(options.format or ["spz"])
    from framework.records.record import RECORD
    from framework.records.run_files import EXPORT

    folder = options.out or options.run / EXPORT
    require(
        folder.resolve() != options.run.resolve(),
        f"--out: expected another folder than the run's, got {folder}; the cameras of the run would"
        " be lost",
    )
    require(
        not (folder / RECORD).exists(),
        f"--out: expected a folder that is no run's, got {folder}; the cameras of that run would be"
        " lost",
    )
    _check_no_cameras_of_others(folder)
    import numpy as np

    from framework.exports.flight import distance, lens_of
    from framework.exports.opened import open_run
    from framework.exports.rig import rig
    from framework.exports.upright import moved_camera, moved_gaussians, upright
    from framework.records.first_view import SETTINGS, settings

    run = open_run(options.run)
    cameras = [named.camera for named in run.cameras]
    away = distance(run, rig(cameras), lens_of(cameras, None))
    motion = upright(rig(cameras), away) if options.frame == "upright" else np.eye(4)
    if options.frame == "upright":
        cameras = [moved_camera(camera, motion) for camera in cameras]
        moved = [replace(a, camera=b) for a, b in zip(run.cameras, cameras, strict=True)]
        run = replace(run, gaussians=moved_gaussians(run.gaussians, motion), cameras=tuple(moved))
    # before the first is written, as a format may refuse the model
    files = {f"{NAME}{SUFFIXES[k]}": packed(run.gaussians, run.background, k) for k in kinds}
    loss = ""
    if options.compact:
        files[f"{NAME}{SUFFIXES['spz']}"], loss = _compact(run, motion)
    make_folder(folder)
    _write_cameras(folder, [named.name for named in run.cameras], cameras, run.near)
    write_whole(folder / SETTINGS, settings(cameras, run.background.tolist(), away))
    for name, content in files.items():
        write_whole(folder / name, content)
        size = f"{len(content) / 1e3:.0f} kB" if loss else f"{len(content) / 1e6:.2f} MB"
        print(f"export: {name} {size}{loss}", flush=True)
    print(
        f"export: {len(run.gaussians):,} Gaussians in {folder}, with their cameras and {SETTINGS}"
    )
    return 0


def _compact(run: OpenedRun, motion: Array) -> tuple[bytes, str]:
    """The smallest SPZ file of a moved run, and what it loses."""
    from framework.exports.compact import compact, mean_psnr, read_photos
    from framework.exports.upright import moved_camera

    train, test = (
        [replace(photo, camera=moved_camera(photo.camera, motion)) for photo in photos]
        for photos in read_photos(run.folder)
    )
    result = compact(run, train)
    photos, kind = (test, "test") if test else (train, "training")
    if not photos:
        return result.content, ", loss not measured as the run has no photos"
    before, after = (mean_psnr(run, g, photos) for g in (run.gaussians, result.gaussians))
    shown = f"{len(photos)} {kind} photo{'' if len(photos) == 1 else 's'}"
    return result.content, (
        f", PSNR {after:.2f} dB on {shown}, {after - before:+.3f} dB compared"
        f" with the stored Gaussians (SH degree {result.precision.degree} of"
        f" {run.gaussians.sh_degree}, coordinates in 1/{2**result.precision.fraction})"
    )


def _check_no_cameras_of_others(folder: Path) -> None:
    """Raise UserError if camera files that no export wrote would be overwritten: a folder of photos
    may have a transforms.json. Exports also write a first view."""
    from framework.records.cameras import CAMERAS, TRANSFORMS
    from framework.records.first_view import SETTINGS

    others = [name for name in (CAMERAS, TRANSFORMS) if (folder / name).exists()]
    require(
        not others or (folder / SETTINGS).exists(),
        f"--out: expected a new folder or one of an earlier export, got {folder}, whose"
        f" {others[0] if others else ''} would be lost; choose another",
    )


def _kinds(asked: list[str]) -> list[str]:
    """Return the formats to write, all of which can be written; `all` skips the others.

    Raises UserError before anything is written if the package of a named format is missing.
    """
    if "all" not in asked:
        for kind in asked:
            check_writer(kind)
        return list(dict.fromkeys(asked))
    for kind in SUFFIXES:
        if not can_write(kind):
            print(f"export: without {kind}; pip install 'fishersplat[{kind}]' writes it too")
    return [kind for kind in SUFFIXES if can_write(kind)]


def _write_cameras(folder: Path, names: list[str], cameras: list[Camera], near: float) -> None:
    import torch

    from framework.records.cameras import write_cameras
    from framework.types import View

    views = [
        View(name, camera, torch.empty(3, 0, 0))
        for name, camera in zip(names, cameras, strict=True)
    ]
    write_cameras(folder, views, [], near)


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument(
        "--format",
        nargs="+",
        choices=[*SUFFIXES, "all"],
        metavar="FORMAT",
        help=f"one or more of {', '.join(SUFFIXES)}, or all (default: spz)",
    )
    parser.add_argument(
        "--compact",
        action="store_true",
        help="write the smallest SPZ whose PSNR on training photos is at most 0.05 dB lower, and"
        " print what it loses on the test photos",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the files (default: RUN/export)"
    )
    parser.add_argument(
        "--frame",
        choices=("upright", "scene"),
        default="upright",
        help="turned and moved as viewers expect it, or in the world of the photos' cameras"
        " (default: upright)",
    )
    return parser
