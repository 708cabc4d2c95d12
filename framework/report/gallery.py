"""Pictures of the page's viewer: ground truth, renders and error maps as small WebP copies.

A page contains at most `BYTES_PER_RUN` of them for each run, within `FEWEST_BYTES` and
`MOST_BYTES`, and at most `MOST_IMAGES`. The lowest seed and most informative view of every method
come first, then its other views, then the next seeds. Copies are at most `LONGEST` pixels long.
Error maps are mostly noise, so `LONGEST_ERROR` applies to them. Every number of the report is
computed from the originals.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from framework.files.limits import IMAGE_BYTES
from framework.files.opened import is_file, read_bytes
from framework.records.run_files import VIDEOS, VIEW
from framework.report.figures.views import choose_views, image_file, picture, psnr_text
from framework.report.render import data_uri, webp_bytes
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import outside
from framework.report.tables import run_link

BYTES_PER_RUN, FEWEST_BYTES, MOST_BYTES = 75_000, 600_000, 4_000_000
MOST_IMAGES = 1500
VIDEO_BYTES, VIDEOS_BYTES = 600_000, 6_000_000  # of one that a page holds, and of all
VIDEO_TYPES = {
    ".mp4": "video/mp4",
    ".webm": "video/webm",
    ".webp": "image/webp",
    ".gif": "image/gif",
}
LONGEST, LONGEST_ERROR = 480, 240


@dataclass
class Gallery:
    """The data of the viewer.

    Attributes:
        images: data URIs.
        shots: scene, method, seed, view, PSNR as text, indices of truth, render and error in
            `images`, and index of the method.
        looks: scene, method, seed, text and target of links to other views of that run.
        videos: scene, method, seed and data URI of the small video of a method's first run.
        size: bytes before base64, without videos.
        left_out: number of shots that did not fit.
    """

    images: list[str] = field(default_factory=list)
    shots: list[tuple[str, str, int, str, str, int, int, int, int]] = field(default_factory=list)
    looks: list[tuple[str, str, int, str, str]] = field(default_factory=list)
    videos: list[tuple[str, str, int, str]] = field(default_factory=list)
    size: int = 0
    left_out: int = 0

    @property
    def data(self) -> dict[str, Any]:
        """For the page's script."""
        kinds = ("images", "shots", "looks", "videos", "left_out")
        return {name: getattr(self, name) for name in kinds} | {"longest": LONGEST}


def gallery(study: Study, scenes: Sequence[str]) -> Gallery:
    """The pictures of all complete runs on `scenes`, as far as they fit."""
    pictures = Gallery()
    copies: dict[bytes | Path, int] = {}
    for run in study.runs if scenes else ():
        for text, names in (("in 3D", (VIEW,)), ("video", VIDEOS)):
            link = run_link(study, run, text, names) if run.scene in scenes else None
            if link is not None:
                look = (run.scene, run.method.name, run.seed, link.text, link.target)
                pictures.looks.append(look)
    pictures.videos = list(_videos(study, scenes))
    most = min(MOST_BYTES, max(FEWEST_BYTES, BYTES_PER_RUN * len(study.runs)))
    for layer in _layers(study, scenes):
        if pictures.size >= most or len(pictures.images) >= MOST_IMAGES:
            pictures.left_out += len(layer)
            continue
        for run, view in layer:
            truth = image_file(run, view, "truth")
            if truth not in copies:
                copies[truth] = _add(pictures, run, view, "truth", copies)
            indices = (
                copies[truth],
                _add(pictures, run, view, "render"),
                _add(pictures, run, view, "error", longest=LONGEST_ERROR),
                study.families.index(run.method.family),
            )
            name = (run.scene, run.method.name, run.seed, outside(view), psnr_text(run, view))
            pictures.shots.append((*name, *indices))
    return pictures


def _videos(study: Study, scenes: Sequence[str]) -> Iterator[tuple[str, str, int, str]]:
    """The small videos of each method on each scene; larger ones are linked."""
    left = VIDEOS_BYTES
    for scene in scenes:
        for method in study.methods:
            files = [(r, r.run.run_dir / n) for r in study.of(scene, method) for n in VIDEOS]
            run, file = next(((r, f) for r, f in files if is_file(f)), (None, None))
            if run is None or file is None or file.stat().st_size > min(VIDEO_BYTES, left):
                continue
            content = read_bytes(file, VIDEO_BYTES)
            left -= len(content)
            yield scene, method.name, run.seed, data_uri(content, VIDEO_TYPES[file.suffix])


def _layers(study: Study, scenes: Sequence[str]) -> Iterator[list[tuple[ReportRun, str]]]:
    """Group the pairs of run and view by rank of the seed, then of the view."""
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
    pictures: Gallery,
    run: ReportRun,
    view: str,
    kind: str,
    copies: dict[bytes | Path, int] | None = None,
    longest: int = LONGEST,
) -> int:
    """Index of the image's copy; equal files are kept once if `copies` is given."""
    original = read_bytes(image_file(run, view, kind), IMAGE_BYTES)
    if copies is not None and original in copies:
        return copies[original]
    copy = webp_bytes(picture(run, view, kind), longest)
    pictures.size += len(copy)
    pictures.images.append(data_uri(copy))
    if copies is not None:
        copies[original] = len(pictures.images) - 1
    return len(pictures.images) - 1
