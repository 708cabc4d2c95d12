"""The pictures of the page's viewer: ground truth, renders and error maps as small WebP copies.

A page holds at most `CAP_BYTES` of them and `CAP_IMAGES` in number, taken in layers: the lowest
seed and most telling view of every method first, then its other views, then the next seeds. What
does not fit is told; the originals lie in the runs' folders. A copy is at most `LONGEST` pixels
long and not meant for measuring: every number of the report is from the originals.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image

from framework.files.limits import IMAGE_BYTES, check_size
from framework.report.figures.views import choose_views, image_file, psnr_of
from framework.report.study.collect import ReportRun, Study
from framework.report.study.labels import outside
from framework.scenes.images import read_image

CAP_BYTES, CAP_IMAGES = 8_000_000, 1500
LONGEST = 640
QUALITY, EFFORT = 82, 2


@dataclass
class Gallery:
    """images: data URIs. shots: scene, method, seed, view, PSNR as text and the indices of truth,
    render and error in `images`. size: bytes before base64. left_out: how many shots did not fit.
    """

    images: list[str] = field(default_factory=list)
    shots: list[tuple[str, str, int, str, str, int, int, int]] = field(default_factory=list)
    size: int = 0
    left_out: int = 0


def gallery(study: Study, scenes: Sequence[str]) -> Gallery:
    """The pictures of all complete runs on `scenes`, as far as they fit."""
    found = Gallery()
    truths: dict[Path, int] = {}
    known: dict[bytes, int] = {}
    for layer in _layers(study, scenes):
        if found.size >= CAP_BYTES or len(found.images) >= CAP_IMAGES:
            found.left_out += len(layer)
            continue
        for run, view in layer:
            truth = image_file(run, view, "truth")
            if truth not in truths:
                truths[truth] = _add(found, truth, known)
            render, error = (_add(found, image_file(run, view, k)) for k in ("render", "error"))
            psnr = psnr_of(run, view)
            text = "infinite" if psnr is None else f"{psnr:.2f} dB"
            shot = (run.scene, run.method, run.seed, outside(view), text)
            found.shots.append((*shot, truths[truth], render, error))
    return found


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


def _add(found: Gallery, path: Path, known: dict[bytes, int] | None = None) -> int:
    """Index of the image's copy; equal files are kept once where `known` is given."""
    check_size(path, IMAGE_BYTES)
    original = path.read_bytes()
    if known is not None and original in known:
        return known[original]
    copy = _copy(path)
    found.size += len(copy)
    found.images.append("data:image/webp;base64," + base64.b64encode(copy).decode())
    if known is not None:
        known[original] = len(found.images) - 1
    return len(found.images) - 1


def _copy(path: Path) -> bytes:
    buffer = io.BytesIO()
    pixels = Image.fromarray(read_image(path))
    pixels.thumbnail((LONGEST, LONGEST), Image.Resampling.LANCZOS)
    pixels.save(buffer, format="WEBP", quality=QUALITY, method=EFFORT)
    return buffer.getvalue()
