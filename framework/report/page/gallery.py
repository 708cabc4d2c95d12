"""The pictures of the page's viewer: ground truth, renders and error maps as small WebP copies.

A page holds at most `BYTES_PER_RUN` of them for each run, within `FEWEST_BYTES` and `MOST_BYTES`,
and `CAP_IMAGES` in number, taken in layers: the lowest seed and most telling view of every method
first, then its other views, then the next seeds. What does not fit is told; the originals lie in
the runs' folders. A copy is at most `LONGEST` pixels long, an error map, which is mostly noise,
`LONGEST_ERROR`; none is meant for measuring: every number of the report is from the originals.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from framework.files.limits import IMAGE_BYTES
from framework.files.opened import read_bytes
from framework.report.figures.views import choose_views, image_file, picture, psnr_of, reading
from framework.report.study.beside import video_file, video_link, view_link
from framework.report.study.labels import outside
from framework.report.study.runs import ReportRun, Study
from framework.scenes.images import read_image

BYTES_PER_RUN, FEWEST_BYTES, MOST_BYTES = 75_000, 600_000, 4_000_000
CAP_IMAGES = 1500
VIDEO_BYTES, VIDEOS_BYTES = 600_000, 6_000_000  # of one that a page holds, and of all
VIDEO_TYPES = {
    ".mp4": "video/mp4",
    ".webm": "video/webm",
    ".webp": "image/webp",
    ".gif": "image/gif",
}
LONGEST, LONGEST_ERROR = 480, 240
QUALITY, EFFORT = 70, 4


@dataclass
class Gallery:
    """images: data URIs. shots: scene, method, seed, view, PSNR as text and the indices of truth,
    render and error in `images`. looks: scene, method, seed, text and target of a link to
    what else shows that run. videos: scene, method, seed and data URI of the small video of a
    method's first run that has one. size: bytes before base64, without videos. left_out: how many
    shots did not fit.
    """

    images: list[str] = field(default_factory=list)
    shots: list[tuple[str, str, int, str, str, int, int, int]] = field(default_factory=list)
    looks: list[tuple[str, str, int, str, str]] = field(default_factory=list)
    videos: list[tuple[str, str, int, str]] = field(default_factory=list)
    size: int = 0
    left_out: int = 0


def gallery(study: Study, scenes: Sequence[str]) -> Gallery:
    """The pictures of all complete runs on `scenes`, as far as they fit."""
    found = Gallery()
    truths: dict[Path, int] = {}
    known: dict[bytes, int] = {}
    for run in study.runs:
        for link in (view_link(study, run), video_link(study, run)):
            if link is not None and run.scene in scenes:
                found.looks.append((run.scene, run.method, run.seed, link.text, link.target))
    found.videos = list(_videos(study, scenes))
    most = min(MOST_BYTES, max(FEWEST_BYTES, BYTES_PER_RUN * len(study.runs)))
    for layer in _layers(study, scenes):
        if found.size >= most or len(found.images) >= CAP_IMAGES:
            found.left_out += len(layer)
            continue
        for run, view in layer:
            truth = image_file(run, view, "truth")
            if truth not in truths:
                truths[truth] = _add(found, run, view, "truth", known)
            render = _add(found, run, view, "render")
            error = _add(found, run, view, "error", longest=LONGEST_ERROR)
            psnr = psnr_of(run, view)
            text = "infinite" if psnr is None else f"{psnr:.2f} dB"
            shot = (run.scene, run.method, run.seed, outside(view), text)
            found.shots.append((*shot, truths[truth], render, error))
    return found


def _videos(study: Study, scenes: Sequence[str]) -> Iterator[tuple[str, str, int, str]]:
    """Of each method on each scene, as far as they are small; the rest is linked."""
    left = VIDEOS_BYTES
    for scene in scenes:
        for method in study.methods:
            files = [(run, video_file(run)) for run in study.of(scene, method)]
            run, file = next(((r, f) for r, f in files if f is not None), (None, None))
            if run is None or file is None:
                continue
            size = file.stat().st_size
            if size > min(VIDEO_BYTES, left):
                continue
            left -= size
            with reading(run):
                content = base64.b64encode(read_bytes(file, VIDEO_BYTES)).decode()
            uri = f"data:{VIDEO_TYPES[file.suffix]};base64,{content}"
            yield scene, method, run.seed, uri


def _layers(study: Study, scenes: Sequence[str]) -> Iterator[list[tuple[ReportRun, str]]]:
    """By rank of the seed, then of the view: the pairs of run and view of that rank."""
    ranked: dict[tuple[int, int], list[tuple[ReportRun, str]]] = {}
    for scene in scenes:
        first = [view for view, _ in choose_views(study, scene).views]
        for method in study.methods:
            for seed_rank, run in enumerate(study.of(scene, method)):
                views = list(run.files)
                order = [v for v in first if v in views] + [v for v in views if v not in first]
                for view_rank, view in enumerate(order):
                    ranked.setdefault((seed_rank, view_rank), []).append((run, view))
    for rank in sorted(ranked):
        yield ranked[rank]


def _add(
    found: Gallery,
    run: ReportRun,
    view: str,
    kind: str,
    known: dict[bytes, int] | None = None,
    longest: int = LONGEST,
) -> int:
    """Index of the image's copy; equal files are kept once where `known` is given."""
    with reading(run):
        original = read_bytes(image_file(run, view, kind), IMAGE_BYTES)
    if known is not None and original in known:
        return known[original]
    copy = _copy(picture(run, view, kind), longest)
    found.size += len(copy)
    found.images.append(_uri(copy))
    if known is not None:
        known[original] = len(found.images) - 1
    return len(found.images) - 1


def inline_copy(path: Path) -> str:
    """A figure of the report as a data URI, at its own size."""
    return _uri(_copy(read_image(path), None))


def _uri(copy: bytes) -> str:
    return "data:image/webp;base64," + base64.b64encode(copy).decode()


def _copy(pixels: np.ndarray, longest: int | None) -> bytes:
    """longest: side in pixels; None: as it is."""
    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    if longest is not None:
        image.thumbnail((longest, longest), Image.Resampling.LANCZOS)
    image.save(buffer, format="WEBP", quality=QUALITY, method=EFFORT)
    return buffer.getvalue()
