"""Encodes videos: WebM by OpenCV, MP4 by PyAV, animated WebP and GIF by Pillow.

WebM is VP9, which browsers and players support and OpenCV's wheels can write (their FFmpeg is LGPL,
libvpx BSD). They cannot write H.264. PyAV's wheels can, but contain libx264 (GPL), so PyAV is used
if it is installed, and is neither a dependency nor an extra.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import tempfile
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from framework.errors import UserError, require

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Pictures = Sequence[NDArray[np.uint8]]  # [H, W, 3] each, H and W even

SUFFIXES = (".mp4", ".webm", ".webp", ".gif")
# of OpenCV: VP9 of constant quality, medium effort
OPTIONS = "OPENCV_FFMPEG_WRITER_OPTIONS", "crf;30|b;0|row-mt;1|cpu-used;4"
H264 = {"crf": "20", "preset": "medium"}
GIF_FPS = 50


def has_h264() -> bool:
    """Whether PyAV is installed."""
    return importlib.util.find_spec("av") is not None


def check_kind(path: Path, fps: int) -> None:
    """Raise UserError unless a movie of this name with so many pictures a second can be written."""
    kind = path.suffix.lower()
    require(
        kind in SUFFIXES,
        f"--out: expected a name that ends in {', '.join(SUFFIXES)}, got '{path.name}'; rename it",
    )
    require(
        kind != ".mp4" or has_h264(),
        f"{path}: expected PyAV, which writes MP4 (H.264), found none; pip install av, or name the"
        " video .webm",
    )
    require(
        kind != ".gif" or fps <= GIF_FPS,
        f"--fps: expected at most {GIF_FPS} for a GIF, as browsers slow down quicker ones, got"
        f" {fps}; lower it, or name the video .webm",
    )


def encoded(pictures: Pictures, kind: str, fps: int) -> bytes:
    """The file's content.

    Args:
        kind: one of `SUFFIXES`.
    """
    if kind == ".mp4":
        return _mp4(pictures, fps)
    return _webm(pictures, fps) if kind == ".webm" else _animated(pictures, kind, fps)


def _mp4(pictures: Pictures, fps: int) -> bytes:
    import av

    height, width = pictures[0].shape[:2]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "video.mp4"
        # the index first, so that a page can play it while it loads
        with av.open(str(file), "w", options={"movflags": "+faststart"}) as container:
            stream = container.add_stream("h264", rate=Fraction(fps), options=H264)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            for picture in pictures:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
        return file.read_bytes()


def _webm(pictures: Pictures, fps: int) -> bytes:
    import cv2

    height, width = pictures[0].shape[:2]
    os.environ.setdefault(*OPTIONS)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "video.webm"
        code = cv2.VideoWriter.fourcc(*"VP90")
        with _quiet():  # OpenCV warns that the container has no tag
            writer = cv2.VideoWriter(str(file), cv2.CAP_FFMPEG, code, float(fps), (width, height))
        if not writer.isOpened():
            raise UserError(
                "video: expected an OpenCV that writes VP9, got one that does not; name the video"
                " .webp"
            )
        for picture in pictures:
            writer.write(picture[..., ::-1].copy())
        writer.release()
        return file.read_bytes()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Discard what C libraries write to standard error."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _animated(pictures: Pictures, kind: str, fps: int) -> bytes:
    from PIL import Image

    first, *rest = [Image.fromarray(picture) for picture in pictures]
    out = io.BytesIO()
    tick = 1 if kind == ".webp" else 10  # ms: GIF counts hundredths of a second
    ends = [tick * round(1000 / tick * (i + 1) / fps) for i in range(len(pictures))]
    duration = [end - begin for begin, end in pairwise([0, *ends])]  # together as long as asked
    if kind == ".webp":
        first.save(
            out, "WEBP", save_all=True, append_images=rest, duration=duration, loop=0, quality=75
        )
    else:
        first.save(out, "GIF", save_all=True, append_images=rest, duration=duration, loop=0)
    return out.getvalue()
