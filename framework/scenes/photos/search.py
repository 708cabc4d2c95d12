"""The search for poses, as the child process that `child` starts does it.

    python -m framework.scenes.photos.search   < request

It leaves `images`, `sparse/0` and `poses.json` in the folder of the request.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any, TextIO

from framework.compute.orphans import watch
from framework.errors import UserError, mendable, os_line, require
from framework.scenes.photos.advice import failure, tells_no_depth
from framework.scenes.photos.attempt import Attempt, attempt
from framework.scenes.photos.found import Found, Try, write_found
from framework.scenes.photos.model import store
from framework.scenes.photos.prepare import Photo, prepare
from framework.scenes.photos.source import FEWEST
from framework.scenes.photos.steps import STEPS
from framework.scenes.photos.telling import Telling
from framework.scenes.photos.video import sharpest_frames


def main() -> None:
    """Search, and tell the parent."""
    out = _own_stdout()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent, interrupted too, ends this process
    request = json.load(sys.stdin)
    watch(request["parent"])
    telling = Telling(out, request["period_s"])
    try:
        search(request, telling)
    except UserError as error:
        telling.error(str(error))
    except OSError as error:
        if not mendable(error):
            raise
        telling.error(os_line(error, error.filename or request["folder"]))


def _own_stdout() -> TextIO:
    """A stream to the parent; what else writes to standard output goes where errors go."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return out


def search(request: dict[str, Any], telling: Telling) -> None:
    """Raises UserError where too few photos find a place."""
    started, folder = time.monotonic(), Path(request["folder"])
    photos = _prepared(request, folder, telling)
    best, tries, seconds = _best(photos, folder, request["threads"], telling)
    found = Found(
        photos=[photo.name for photo in photos],
        placed=best.placed,
        groups=best.groups,
        features=best.features,
        links=best.links,
        tries=tries,
        seconds=time.monotonic() - started,
        held=best.held,
        overruled=best.overruled,
        video=request["video"],
        reduced=any(photo.reduced for photo in photos),
        copies=request["copies"],
    )
    if len(found.placed) < FEWEST or tells_no_depth(found.links, found.placed):
        raise UserError(failure(Path(request["files"][0]), found))
    store(best, photos, folder)
    write_found(folder, found)
    telling.say(f"{len(found.placed)} of {len(photos)} photos placed in {seconds:.0f} s")


def _prepared(request: dict[str, Any], folder: Path, telling: Telling) -> list[Photo]:
    """The photos, upright and reduced, in `images`."""
    files = [Path(file) for file in request["files"]]
    if request["video"]:
        frames = folder / "frames"
        frames.mkdir()
        files = sharpest_frames(
            files[0], request["frames"], frames, telling.ticks("frames of the video read")
        )
    images = folder / "images"
    images.mkdir()
    tick = telling.ticks("photos read")
    photos = []
    for number, file in enumerate(files):
        photos.append(prepare(file, images, number, request["side"]))
        tick(number + 1, len(files))
    shutil.rmtree(folder / "frames", ignore_errors=True)
    names = [photo.name for photo in photos]
    require(
        len(set(names)) == len(names),
        f"{files[0].parent}: expected names that differ by more than JPEG or PNG, got"
        f" {_repeated(names)} twice; rename one",
    )
    return photos


def _repeated(names: list[str]) -> str:
    return next((name for k, name in enumerate(names) if name in names[:k]), "none")


def _best(
    photos: list[Photo], folder: Path, threads: int, telling: Telling
) -> tuple[Attempt, list[Try], float]:
    """The first attempt that places all photos, else the one that places most; the tries; and the
    seconds of all."""
    best, tries, started = None, [], time.monotonic()
    for k, step in enumerate(STEPS):
        work = folder / f"try{k}"
        work.mkdir()
        so_far = f", {len(best.placed)} placed so far" if best else ""
        telling.label = f"poses, try {k + 1} of {len(STEPS)} ({step.name}{so_far})"
        made = attempt(step, photos, folder / "images", work, threads, telling)
        shutil.rmtree(work)
        tries.append(made.told)
        if best is None or len(made.placed) > len(best.placed):
            best = made
        # nor would other features tell any depth
        if len(best.placed) == len(photos) or tells_no_depth(made.links, made.placed):
            break
        in_groups = len(best.placed) + len(set().union(*best.groups))
        if k > 0 and in_groups == len(photos):  # nobody is lost: they are different scenes
            break
        telling.say(
            f"try {k + 1} of {len(STEPS)}, {step.name}: {len(made.placed)} of {len(photos)} photos"
            f" placed after {time.monotonic() - started:.0f} s"
        )
    assert best is not None, "there is a step"
    return best, tries, time.monotonic() - started


if __name__ == "__main__":
    main()
