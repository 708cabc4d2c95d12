"""The child process that searches for poses; see `process`.

    python -m framework.scenes.photos.search   < request

It leaves `images`, `sparse/0` and `poses.json` in the folder of the request.
"""

import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from framework.compute.orphans import watch
from framework.errors import UserError, mendable, os_line, require
from framework.scenes.photos.advice import failure, shows_no_depth
from framework.scenes.photos.attempt import Attempt, attempt
from framework.scenes.photos.options import Step, steps
from framework.scenes.photos.prepare import Photo, prepare
from framework.scenes.photos.process import Messages
from framework.scenes.photos.result import Poses, Result, Try, write_result
from framework.scenes.photos.source import FEWEST
from framework.scenes.photos.video import sharpest_frames


def main() -> None:
    """Search, and send messages to the parent."""
    out = _own_stdout()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent, interrupted too, ends this process
    request = json.load(sys.stdin)
    watch(request["parent"])
    messages = Messages(out, request["period_s"])
    try:
        search(request, messages)
    except UserError as error:
        messages.error(str(error))
    except OSError as error:
        if not mendable(error):
            raise
        messages.error(os_line(error, error.filename or request["folder"]))


def _own_stdout() -> TextIO:
    """A stream to the parent; all other output goes to standard error."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return out


def search(request: dict[str, Any], messages: Messages) -> None:
    """Search for the poses that `request` describes.

    Raises:
        UserError: if too few are found.
    """
    started, folder = time.monotonic(), Path(request["folder"])
    photos = _prepared(request, folder, messages)
    best, tries = _best(steps(request["matching"]), photos, folder, request["threads"], messages)
    seconds = time.monotonic() - started
    result = Result(
        **{field.name: getattr(best, field.name) for field in fields(Poses)},
        photos=[photo.name for photo in photos],
        tries=tries,
        seconds=seconds,
        video=request["video"],
        reduced=any(photo.reduced for photo in photos),
        copies=request["copies"],
    )
    if len(result.placed) < FEWEST or shows_no_depth(result.links, result.placed):
        raise UserError(failure(Path(request["files"][0]), result))
    store(best, photos, folder)
    write_result(folder, result)
    messages.say(f"{len(result.placed)} of {len(photos)} photos placed in {seconds:.0f} s")


def _prepared(request: dict[str, Any], folder: Path, messages: Messages) -> list[Photo]:
    """The photos, upright and reduced, in `images`."""
    files = [Path(file) for file in request["files"]]
    if request["video"]:
        frames = folder / "frames"
        frames.mkdir()
        count = messages.counter("frames of the video read")
        files = sharpest_frames(files[0], request["frames"], frames, count)
    images = folder / "images"
    images.mkdir()
    count = messages.counter("photos read")
    photos = []
    for number, file in enumerate(files):
        photos.append(prepare(file, images, number, request["side"]))
        count(number + 1, len(files))
    shutil.rmtree(folder / "frames", ignore_errors=True)
    names = [photo.name for photo in photos]
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    require(
        not twice,
        f"{files[0].parent}: expected names that differ by more than JPEG or PNG, got"
        f" {''.join(twice[:1])} twice; rename one",
    )
    return photos


def _best(
    chosen: Sequence[Step], photos: list[Photo], folder: Path, threads: int, messages: Messages
) -> tuple[Attempt, list[Try]]:
    """The first attempt that places all photos, else the one that places most; and all tries."""
    best, tries, started = Attempt(), [], time.monotonic()
    for k, step in enumerate(chosen):
        work = folder / f"try{k}"
        work.mkdir()
        so_far = f", {len(best.placed)} placed so far" if k else ""
        messages.label = f"poses, try {k + 1} of {len(chosen)} ({step.name}{so_far})"
        latest, timing = attempt(step, photos, folder / "images", work, threads, messages)
        shutil.rmtree(work)
        tries.append(timing)
        if k == 0 or len(latest.placed) > len(best.placed):
            best = latest
        # other features would show no depth either
        if len(best.placed) == len(photos) or shows_no_depth(latest.links, latest.placed):
            break
        in_groups = len(best.placed) + len(set().union(*best.groups))
        if k > 0 and in_groups == len(photos):  # the photos show different scenes
            break
        messages.say(
            f"try {k + 1} of {len(chosen)}, {step.name}: {len(latest.placed)} of {len(photos)}"
            f" photos placed after {time.monotonic() - started:.0f} s"
        )
    return best, tries


def store(chosen: Attempt, photos: Sequence[Photo], folder: Path) -> None:
    """Write the upright model to `sparse/0`, and give the placed images the photos' names.

    Images move to a new folder, as a photo may have the name of another prepared one.
    """
    import pycolmap

    model = chosen.model
    names = {photo.stored: photo.name for photo in photos}
    views = [model.image(i).cam_from_world().matrix() for i in sorted(model.reg_image_ids())]
    turn, center = upright(np.array(views))
    model.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(turn), -turn @ center))
    for image in model.images.values():
        image.name = names[image.name]
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    model.write_binary(sparse)
    prepared = folder / "prepared"
    (folder / "images").rename(prepared)
    (folder / "images").mkdir()
    for stored, name in names.items():
        if name in chosen.placed:
            (prepared / stored).rename(folder / "images" / name)
    shutil.rmtree(prepared)


def upright(views: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rotation [3, 3] and centre [3] of a world with +y down and +z along the mean view.

    The models have an arbitrary orientation. Photos are mostly held level, so the mean of
    their down axes is down; viewers that open the splat then show it upright.

    Args:
        views: [n, 3, 4] world-to-camera of the cameras, which will surround the origin.
    """
    rotations = views[:, :, :3]
    center = -np.einsum("nij,ni->nj", rotations, views[:, :, 3]).mean(axis=0)
    down = rotations[:, 1].mean(axis=0)
    if np.linalg.norm(down) < 0.1:  # photos in all orientations
        down = rotations[0, 1]
    y = down / np.linalg.norm(down)
    ahead = rotations[:, 2].mean(axis=0)
    level = ahead - (ahead @ y) * y
    if np.linalg.norm(level) < 0.01:  # cameras all around, or all looking down
        level = np.cross(rotations[0, 0], y)
    z = level / np.linalg.norm(level)
    return np.stack([np.cross(y, z), y, z]), center


if __name__ == "__main__":
    main()
