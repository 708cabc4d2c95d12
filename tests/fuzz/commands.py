"""What the subcommands and `scene=photos` read, as they read it: two runs that are compared, all
studies, runs of which a video, pictures or files are made, photos, a video, kept poses, and what a
browser asks of the server of `view`."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import os
import shutil
import socket
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from framework.errors import UserError
from framework.exports import render
from framework.files.opened import read_bytes
from framework.report.build import build_report
from framework.report.leaderboard import leaderboard
from framework.report.pair import compare_runs
from framework.scenes.photos.advice import advice
from framework.scenes.photos.prepare import prepare
from framework.scenes.photos.result import Link, Overruled, Result, Try, read_result, write_result
from framework.scenes.photos.source import find_source
from framework.scenes.photos.video import sharpest_frames
from framework.view.server import PageServer, _Handler
from tests.record.fakes import fake_run
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


def two_runs(folder: Path) -> None:
    fake_run(folder, run_name="a")
    fake_run(folder, "safi", run_name="b")


def compared(folder: Path) -> None:
    with _out() as out:
        compare_runs(folder / "runs" / "a", folder / "runs" / "b", out)


def two_studies(folder: Path) -> None:
    """One of runs, and one of which only the table is left."""
    for name in ("one", "two"):
        for seed in range(2):
            fake_run(folder / name, seed=seed, run_name=f"a{seed}")
            fake_run(folder / name, "safi", seed=seed, run_name=f"b{seed}")
    build_report(folder / "two")
    shutil.rmtree(folder / "two" / "runs")


def all_studies(folder: Path) -> None:
    """One is told whatever the other is; what cannot be read, in a line."""
    with _out() as out:
        told = leaderboard(folder, out)[0].read_text(encoding="utf-8")
        (out / "leaderboard.html").read_text(encoding="utf-8")
    assert "| one" in told or "| two" in told, "neither study is told"
    if "| one" not in told or "| two" not in told or "damaged" in told:
        raise UserError("a damaged study is told")


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


def kept_poses(folder: Path) -> None:
    names = [f"im{k:02d}.jpg" for k in range(5)]
    found = Result(
        photos=names,
        placed={name: 100 + k for k, name in enumerate(names[:3])},
        groups=[names[3:]],
        features={name: 1000 for name in names},
        links=[Link(names[0], names[1], 80, 0.1), Link(names[1], names[2], 60, 0.2)],
        tries=[Try("usual", 3, 1.0, 1.0, 1.0)],
        seconds=3.0,
        copies={"copy.jpg": names[0]},
        overruled=Overruled(377.0, 609.0, None, 0.2),
    )
    write_result(folder, found)


def poses_told(folder: Path) -> None:
    found = read_result(folder)
    for line in advice(found):
        assert "\n" not in line
    for name in found.placed:
        assert Path(name).name == name, "a name that leads elsewhere"


def request(folder: Path) -> None:
    (folder / "asked.line").write_bytes(
        b"GET /?a=1 HTTP/1.1\r\nHost: localhost:80\r\nContent-Length: 3\r\nX-A: b\r\n\r\nabc"
    )


class _Served(PageServer):
    def __init__(self) -> None:  # without a port
        self.page, self.server_port = PAGE.encode(), 80


def answered(folder: Path) -> None:
    """The server answers, or hangs up; nothing but the page leaves it."""
    asked, told = read_bytes(folder / "asked.line", 1 << 20), io.BytesIO()

    class Connection:
        def makefile(self, *_: object) -> io.BytesIO:
            return io.BytesIO(asked)

        def sendall(self, data: bytes) -> None:
            told.write(data)

        def settimeout(self, _: float) -> None: ...

        def setsockopt(self, *_: object) -> None: ...

    with contextlib.suppress(socket.timeout):
        _Handler(Connection(), ("127.0.0.1", 1), _Served())  # type: ignore[arg-type]
    answer = told.getvalue()
    assert b"root:" not in answer and os.getcwdb() not in answer
    if PAGE.encode() not in answer:
        raise UserError("refused")
