"""What the subcommands and `scene=photos` read: a run of which a video, pictures or files are
made, and photos."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from framework.exports import render
from framework.scenes.photos.prepare import prepare
from tests.view.runs import seen_run

RUN = ("record.json", "metrics.csv", "history.csv")
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
            run, inputs = folder / "runs" / "run", [word.format(out=out) for word in words]
            cameras = ["--cameras", str(run / "cameras.json")] if main is render.main else []
            assert main([str(run), *inputs, *cameras], "fuzz") == 0

    return read


def photo(folder: Path, kind: str) -> None:
    """A photo; unless it is a PNG, it is rotated and has a lens."""
    pixels = np.arange(48 * 96 * 3, dtype=np.uint32).reshape(48, 96, 3).astype(np.uint8)
    image = Image.fromarray(pixels)
    exif = image.getexif()
    if kind != "png":
        exif[ORIENTATION], exif[MAKE] = 6, "Maker"
        exif.get_ifd(EXIF_IFD)[EXIF_FOCAL_35MM] = 28
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
