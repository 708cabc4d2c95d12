"""Pictures of the page's viewer: ground truth, renders and error maps as small WebP copies.

A page contains at most `BYTES_PER_RUN` of them for each run, within `FEWEST_BYTES` and
`MOST_BYTES`, and at most `MOST_IMAGES`. The lowest seed and most informative view of every method
come first, then its other views, then the next seeds. Copies are at most `LONGEST` pixels long.
Error maps are mostly noise, so `LONGEST_ERROR` applies to them. Every number of the report is
computed from the originals.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
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
class _Album:
    """The copies of a page.

    Attributes:
        images: data URIs.
        size: bytes before base64.
        indices: file content -> its index in `images`.
    """

    images: list[str] = field(default_factory=list)
    size: int = 0
    indices: dict[bytes, int] = field(default_factory=dict)

    def add(self, run: ReportRun, view: str, kind: str) -> int:
        """Index of the image's copy; equal files are kept once."""
        original = read_bytes(image_file(run, view, kind), IMAGE_BYTES)
        if original not in self.indices:
            longest = LONGEST_ERROR if kind == "error" else LONGEST
            copy = webp_bytes(picture(run, view, kind), longest)
            self.size += len(copy)
            self.images.append(data_uri(copy))
            self.indices[original] = len(self.images) - 1
        return self.indices[original]


def gallery(study: Study, scenes: Sequence[str]) -> dict[str, Any]:
    """The pictures of all complete runs on `scenes`, as far as they fit, for the page's script.

    Returns:
        `images`: data URIs.
        `shots`: scene, method, seed, view, PSNR as text, indices of truth, render and error in
        `images`, and index of the method.
        `looks`: scene, method, seed, text and target of links to other views of that run.
        `videos`: scene, method, seed and data URI of the small video of a method's first run.
        `left_out`: number of shots that did not fit.
        `longest`: pixels of a copy's longer side.
    """
    album, shots, left_out = _Album(), [], 0
    most = min(MOST_BYTES, max(FEWEST_BYTES, BYTES_PER_RUN * len(study.runs)))
    for layer in _layers(study, scenes):
        if album.size >= most or len(album.images) >= MOST_IMAGES:
            left_out += len(layer)
            continue
        for run, view in layer:
            indices = [album.add(run, view, kind) for kind in ("truth", "render", "error")]
            name = (run.scene, run.method.name, run.seed, outside(view), psnr_text(run, view))
            shots.append((*name, *indices, study.families.index(run.method.family)))
    return {
        "images": album.images,
        "shots": shots,
        "looks": _looks(study, scenes),
        "videos": list(_videos(study, scenes)),
        "left_out": left_out,
        "longest": LONGEST,
    }


def _looks(study: Study, scenes: Sequence[str]) -> list[tuple[str, str, int, str, str]]:
    return [
        (run.scene, run.method.name, run.seed, link.text, link.target)
        for run in study.runs
        if run.scene in scenes
        for text, names in (("in 3D", (VIEW,)), ("video", VIDEOS))
        if (link := run_link(study, run, text, names)) is not None
    ]


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
        _, first = choose_views(study, scene)
        for method in study.methods:
            for seed_rank, run in enumerate(study.of(scene, method)):
                views = list(run.files)
                order = [v for v in first if v in views] + [v for v in views if v not in first]
                for view_rank, view in enumerate(order):
                    ranked.setdefault((seed_rank, view_rank), []).append((run, view))
    for rank in sorted(ranked):
        yield ranked[rank]
