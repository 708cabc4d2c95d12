"""`fishersplat render RUN --cameras FILE`: the pictures of a finished run from given cameras, as
PNG files in a folder."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import Arguments, require
from framework.exports.video import add_look, check_side
from framework.files.whole import make_folder, write_whole

if TYPE_CHECKING:
    from framework.types import Camera

MOST_PIXELS = 20_000_000  # of a picture; the kernels take about 100 bytes for each


def main(arguments: list[str], prog: str) -> int:
    """Exit status 0.

    Raises:
        UserError: for bad input.
    """
    options = _parser(prog).parse_args(arguments)
    check_side(options.size)
    require(
        options.cameras.exists() and not options.cameras.is_dir(),
        f"--cameras: expected a cameras.json as 3DGS writes it or a transforms.json, got"
        f" '{options.cameras}', which is no file; a run's folder has both",
    )
    from framework.exports.opened import open_run, read_named_cameras
    from framework.exports.pictures import Ticks, painter
    from framework.records.record import RECORD
    from framework.records.run_files import PHOTOS, PICTURES, RENDERS, WRITER, file_stems, png

    named = read_named_cameras(options.cameras)
    cameras = [_resized(one.camera, options.size) for one in named]
    run = open_run(options.run)
    folder = options.out or options.run / PICTURES
    require(
        not (folder.parent / RECORD).exists() or folder.name not in (RENDERS, PHOTOS),
        f"--out: expected a folder for new pictures, got {folder}, which holds those of a run;"
        " choose another",
    )
    stems = file_stems([_bare(one.name) for one in named])
    _check_no_pictures_of_others([folder / f"{stem}.png" for stem in stems])
    make_folder(folder)
    distorted = sum(one.distorted for one in named)
    if distorted:
        print(f"note: {distorted} of {len(named)} cameras have a lens distortion, which is ignored")
    brush, tick = painter(run, options.show, cameras), Ticks("pictures")
    for number, (stem, camera) in enumerate(zip(stems, cameras, strict=True)):
        write_whole(folder / f"{stem}.png", png(brush.picture(camera), WRITER))
        tick(number + 1, len(cameras))
    print(f"render: {len(cameras)} pictures in {folder}")
    return 0


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument("run", type=Path, metavar="RUN", help="folder of a finished run")
    parser.add_argument(
        "--cameras",
        type=Path,
        required=True,
        metavar="FILE",
        help="a cameras.json as 3DGS writes it, or a transforms.json",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the pictures (default: RUN/pictures)"
    )
    add_look(parser, "as in the file")
    return parser


def _resized(camera: Camera, side: int | None) -> Camera:
    """Scale a camera to `side` pixels as the longer side."""
    if side is not None:
        longer = max(camera.width, camera.height)
        width, height = (max(1, round(s * side / longer)) for s in (camera.width, camera.height))
        K = camera.K.clone()
        K[0] *= width / camera.width
        K[1] *= height / camera.height
        camera = replace(camera, K=K, width=width, height=height)
    pixels = camera.width * camera.height
    require(
        pixels <= MOST_PIXELS,
        f"--cameras: expected pictures of at most {MOST_PIXELS:,} pixels, got {camera.width}x"
        f"{camera.height}; give --size",
    )
    return camera


def _bare(name: str) -> str:
    """The name without its folder and the suffix of a picture."""
    file = Path(name).name
    is_picture = file.lower().endswith((".png", ".jpg", ".jpeg"))
    return file.rsplit(".", 1)[0] if is_picture else file


def _check_no_pictures_of_others(files: list[Path]) -> None:
    """Raise UserError if a picture that this command did not write would be overwritten, as a photo
    may be named like its camera."""
    from framework.records.run_files import is_rendered

    others = [file for file in files if file.exists() and not is_rendered(file)]
    require(
        not others,
        f"--out: expected a folder for new pictures, got one with"
        f" {others[0] if others else ''}, which fishersplat render did not write and which would be"
        " lost; choose another",
    )
