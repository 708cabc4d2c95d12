"""What the subcommands and `scene=photos` read: a run of which a video, pictures or files are made,
photos, and a video."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from framework.exports import render
from framework.scenes.photos.prepare import prepare
from framework.scenes.photos.source import find_source
from framework.scenes.photos.video import sharpest_frames
from tests.view.runs import seen_run

PAGE = "<p>the page</p>"
RUN = ("record.json", "metrics.csv", "history.csv")
HEIC_WRITER = "pillow_heif"  # where it is installed, HEIC is among what is read
HAS_HEIC = importlib.util.find_spec(HEIC_WRITER) is not None
EXIF_FOCAL_35MM, EXIF_IFD, ORIENTATION, MAKE = 41989, 0x8769, 274, 271


@contextmanager
def _out() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def small_run(folder: Path) -> None:
    seen_run(folder, run_name="run")


def commanded(main: Callable[[list[str], str], int], *words: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        with _out() as out, contextlib.redirect_stdout(None):
            run, given = folder / "runs" / "run", [word.format(out=out) for word in words]
            cameras = ["--cameras", str(run / "cameras.json")] if main is render.main else []
            assert main([str(run), *given, *cameras], "fuzz") == 0

    return read


def photo(folder: Path, kind: str) -> None:
    """A photo; unless it is a PNG, it lies on its side and a lens is told."""
    pixels = np.arange(48 * 96 * 3, dtype=np.uint32).reshape(48, 96, 3).astype(np.uint8)
    image = Image.fromarray(pixels)
    exif = image.getexif()
    if kind != "png":
        exif[ORIENTATION], exif[MAKE] = 6, "Maker"
        exif.get_ifd(EXIF_IFD)[EXIF_FOCAL_35MM] = 28
    if kind == "heic":
        importlib.import_module(HEIC_WRITER).register_heif_opener()
    image.save(folder / f"a.{kind}", exif=exif)


def prepared(name: str, side: int) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        with _out() as out:
            done = prepare(folder / name, out, 0, side)
            assert max(done.width, done.height) <= side
            assert done.focal_px is None or 0 < done.focal_px < 1e9
            with Image.open(out / done.stored) as image:
                assert image.size == (done.width, done.height)

    return read


def film(folder: Path) -> None:
    import cv2

    out = cv2.VideoWriter(str(folder / "a.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    draw = np.random.default_rng(0)
    for _ in range(6):
        out.write(draw.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    out.release()


def frames(folder: Path) -> None:
    (file,) = find_source(str(folder / "a.avi"), 128, 4).files
    with _out() as out:
        assert 3 <= len(sharpest_frames(file, 4, out, lambda *_: None)) <= 4
