"""`fishersplat video RUN`: a flight through the scene of a finished run, as a video; of a study, a
small one for each method, which its report shows."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import Arguments, require
from framework.files.opened import is_file
from framework.files.whole import make_folder, write_whole
from framework.records import RUN_FOLDERS
from framework.records.record import RECORD, read_record

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from framework.exports.pictures import Painter
    from framework.types import Camera

MOST_FRAMES, MOST_BYTES = 3000, 2**31  # all pictures are in memory until they are encoded
SIDES = (16, 4096)
SMALL_SIDE, SMALL_SECONDS = 320, 4.0  # of a study's videos, which its report contains
FPS = (1, 60)


def main(arguments: list[str], prog: str) -> int:
    """Exit status 0.

    Raises:
        UserError: for bad input.
    """
    options = _parser(prog).parse_args(arguments)
    low, high = FPS
    require(low <= options.fps <= high, f"--fps: expected {low} to {high}, got {options.fps}")
    check_side(options.size)
    seconds = options.seconds
    require(
        seconds is None or (math.isfinite(seconds) and 0 < seconds <= 600),
        f"--seconds: expected a time of up to 600, got {seconds}",
    )
    if is_study(options.run):
        _of_study(options)
    else:
        _film(options, options.run)
    return 0


def _of_study(options: argparse.Namespace) -> None:
    """Make a small video for each method, in the folder of its first run, unless it exists."""
    from framework.records.run_files import VIDEOS

    require(
        options.out is None,
        f"--out: expected none with a study, whose runs keep their videos, got {options.out}",
    )
    small = {"size": options.size or SMALL_SIDE, "seconds": options.seconds or SMALL_SECONDS}
    for run in runs_of_methods(options.run):
        existing = [name for name in VIDEOS if (run / name).is_file()]
        if existing:
            print(f"video: {run / existing[0]} exists")
        else:
            _film(argparse.Namespace(**{**vars(options), **small}), run)
    print(f"video: fishersplat report {options.run} shows them")


def _film(options: argparse.Namespace, folder: Path) -> None:
    """Make the video of one run."""
    from framework.exports.movie import check_kind, encoded, has_h264
    from framework.exports.opened import open_run

    out = options.out or folder / ("video.mp4" if has_h264() else "video.webm")
    check_kind(out, options.fps)
    run = open_run(folder)
    make_folder(out.parent)  # fails before the work
    from framework.exports.flight import flight, lens_of, rig, usual_seconds
    from framework.exports.pictures import painter

    cameras = [named.camera for named in run.cameras]
    path = rig(cameras).kind if options.path == "auto" else options.path
    n = round((options.seconds or usual_seconds(path, len(cameras))) * options.fps)
    lens = lens_of(cameras, options.size)
    _check_room(n, lens, options.show)
    way = flight(run, path, n, lens)
    pictures = _pictures(painter(run, options.show, way), way)
    print(f"encoding {len(pictures)} frames", flush=True)
    content = encoded(pictures, out.suffix.lower(), options.fps)
    write_whole(out, content)
    height, width = pictures[0].shape[:2]
    print(
        f"video: {out} ({path} past {len(cameras)} cameras, {n / options.fps:.1f} s of"
        f" {width}x{height}, {len(content) / 1e6:.1f} MB)"
    )


def is_study(folder: Path) -> bool:
    """Whether `folder` is that of a study, not of a run."""
    return not is_file(folder / RECORD) and (folder / RUN_FOLDERS).is_dir()


def runs_of_methods(folder: Path) -> list[Path]:
    """The complete run of lowest seed of each configuration.

    Raises:
        UserError: if there is none.
    """
    lowest: dict[str, tuple[int, Path]] = {}
    for run in sorted(folder.glob(f"{RUN_FOLDERS}/*")):
        if not is_file(run / RECORD):
            continue
        record = read_record(run / RECORD)
        if record.status != "complete":
            continue
        scene = record.scene.name if record.scene else ""
        rest = {key: value for key, value in record.config.items() if key != "seed"}
        key = json.dumps([scene, rest], sort_keys=True, default=str)
        lowest[key] = min(lowest.get(key, (record.seed, run)), (record.seed, run))
    require(
        bool(lowest), f"{folder}: expected a study with a complete run, found none; run it again"
    )
    return sorted(run for _, run in lowest.values())


def check_side(side: int | None) -> None:
    """Raise UserError for a picture that is too small or too large."""
    least, most = SIDES
    require(
        side is None or least <= side <= most,
        f"--size: expected {least} to {most} pixels, got {side}",
    )


def _parser(prog: str) -> argparse.ArgumentParser:
    parser = Arguments(prog=prog, description=__doc__)
    parser.add_argument(
        "run", type=Path, metavar="RUN", help="folder of a finished run, or of a study"
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="video.mp4, .webm, .webp or .gif (default: in RUN, MP4 with PyAV, else WebM)",
    )
    parser.add_argument(
        "--path",
        choices=("auto", "spline", "spiral", "orbit"),
        default="auto",
        help="way of the camera: through the training cameras and back, a spiral before them, or"
        " once around; auto looks at how the cameras stand (default)",
    )
    add_look(parser, "as in training")
    parser.add_argument("--seconds", type=float, help="length (default: by the path, 4 to 20)")
    parser.add_argument("--fps", type=int, default=24, help="pictures a second (default: 24)")
    return parser


def add_look(parser: argparse.ArgumentParser, size: str) -> None:
    """Add `--show` and `--size`, which is by default as `size` says."""
    parser.add_argument(
        "--show",
        choices=("rgb", "depth", "both"),
        default="rgb",
        help="colour, depth (near is red), or side by side (default: rgb)",
    )
    parser.add_argument("--size", type=int, metavar="PIXELS", help=f"longer side (default: {size})")


def _check_room(n: int, lens: Camera, shown: str) -> None:
    n_bytes = n * lens.width * lens.height * (6 if shown == "both" else 3)
    require(
        2 <= n <= MOST_FRAMES and n_bytes <= MOST_BYTES,
        f"video: expected 2 to {MOST_FRAMES} frames of together at most {MOST_BYTES >> 20:,} MiB,"
        f" got {n} of {n_bytes >> 20:,} MiB; change --seconds, --fps or --size",
    )


def _pictures(painter: Painter, way: list[Camera]) -> list[NDArray[np.uint8]]:
    from framework.exports.pictures import Ticks

    tick, pictures = Ticks("frames"), []
    for camera in way:
        pictures.append(painter.picture(camera))
        tick(len(pictures), len(way))
    return pictures
