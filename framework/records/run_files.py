"""The tables and images of a run's folder; what they hold is described in
`framework.records.record`.

Numbers in CSV are written so that reading returns the same bits. A cell without a value is empty.
"""

from __future__ import annotations

import csv
import functools
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from framework.compute.parallel import run_tasks
from framework.files.limits import RUN_BYTES
from framework.files.opened import is_file, read_text
from framework.files.whole import write_whole
from framework.metrics.evaluate import quantise
from framework.metrics.values import LARGEST, METRICS, Missing, ViewMetrics
from framework.records.record_check import check_columns, check_number, check_stems, check_views

if TYPE_CHECKING:
    from torch import Tensor

    from framework.types import View

ERROR_SCALE = 0.25
PHOTOS, QUALITY = "photos", 90  # folder of the training photos, as JPEG
KINDS = ("", "_truth", "_error", "_mask")  # end the names of a view's files
STEM_LENGTH = 180  # characters of a view's name in those of its files, which take 200
METRICS_CSV, HISTORY_CSV, RENDERS = "metrics.csv", "history.csv", "renders"
VIDEOS = ("video.mp4", "video.webm", "video.webp", "video.gif")  # of `fishersplat video RUN`
VIEW = "view.html"  # the run's page, if `fishersplat view RUN --static` made it
EXPORT, PICTURES = "export", "pictures"  # folders of `fishersplat export` and `fishersplat render`
EXPORTED = ("ply", "compressed.ply", "spz", "splat", "sog")  # endings of `EXPORT`/scene
SOFTWARE, WRITER = "Software", "fishersplat render"  # written into each picture of `PICTURES`
METRIC_COLUMNS = ("view", "tags", *METRICS, "render_s", "file", "missing")
TEXT_COLUMNS = ("view", "tags", "file", "missing")
LOGGED = "log/"  # begins the columns of what plugins log
HISTORY_COLUMNS = ("step", "seconds", "loss", "test_psnr", "gaussians", "sh_degree")


@dataclass(frozen=True)
class Table:
    """The columns of a table by name.

    Attributes:
        texts: a cell without text is "".
        numbers: float64, a cell without a value is NaN.
    """

    texts: Mapping[str, list[str]]
    numbers: Mapping[str, np.ndarray]


EMPTY = Table({}, {})


@dataclass(frozen=True)
class HistoryRow:
    """step: finished steps. seconds: wall time of training so far, without evaluation.
    logged: what plugins logged, a column `log/<name>` each."""

    step: int
    seconds: float
    loss: float
    gaussians: int
    sh_degree: int
    test_psnr: float | None = None
    logged: Mapping[str, float] = field(default_factory=dict)


def file_stems(views: Sequence[str]) -> list[str]:
    """A file name for each view, with odd characters replaced. A name that is taken, whatever its
    letters' case, or that another view's photo or error map has, is numbered."""
    stems: list[str] = []
    taken: set[str] = set()
    last: dict[str, int] = {}  # stem -> its highest number so far
    for view in views:
        stem = re.sub(r"[^A-Za-z0-9._-]", "_", view)[:STEM_LENGTH].lstrip(".") or "view"
        unique, n = stem, last.get(stem, 1)
        while taken & {f"{unique}{kind}".lower() for kind in KINDS}:
            n += 1
            unique = f"{stem}-{n}"
        last[stem] = n
        stems.append(unique)
        taken |= {f"{unique}{kind}".lower() for kind in KINDS}
    return stems


def metrics_csv(metrics: Sequence[ViewMetrics], stems: Sequence[str]) -> str:
    """Format metrics with one row per view and the metrics of plugins last.

    Tags are joined by blanks; `missing` is a JSON object metric -> reason."""
    rows = []
    for entry, stem in zip(metrics, stems, strict=True):
        values = {name: entry.value(name) for name in (*METRICS, *entry.also)}
        reasons = {k: v.reason for k, v in values.items() if isinstance(v, Missing)}
        row: dict[str, object] = {k: v for k, v in values.items() if k not in reasons}
        row |= {"view": entry.view, "tags": " ".join(entry.tags), "render_s": entry.render_s}
        row |= {"file": stem, "missing": json.dumps(reasons) if reasons else ""}
        rows.append(row)
    also = metrics[0].also if metrics else {}
    return csv_text(rows, [*METRIC_COLUMNS, *also])


def history_csv(history: Sequence[HistoryRow]) -> str:
    """Format a history with one row per logged step and one column per logged name, sorted."""
    names = sorted({f"{LOGGED}{name}" for row in history for name in row.logged})
    rows = []
    for row in history:
        cells = {column: _finite(getattr(row, column)) for column in HISTORY_COLUMNS}
        logged = {f"{LOGGED}{name}": _finite(value) for name, value in row.logged.items()}
        rows.append({**cells, **logged})
    return csv_text(rows, [*HISTORY_COLUMNS, *names])


def csv_text(rows: Sequence[Mapping[str, object]], columns: Sequence[str] = ()) -> str:
    """A table of these columns, by default those of the first row."""
    buffer = io.StringIO()
    names = columns or list(rows[0])
    writer = csv.DictWriter(buffer, names, lineterminator="\n", extrasaction="ignore")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def read_table(path: Path) -> Table:
    """A table written here.

    Raises:
        ValueError, IndexError, OverflowError, csv.Error: for other content.
        UserError: for what is
            no file or too large a one.
    """
    columns, *rows = list(csv.reader(io.StringIO(read_text(path, RUN_BYTES), newline="")))
    needed = METRIC_COLUMNS if path.name == METRICS_CSV else HISTORY_COLUMNS
    check_columns(columns, needed)
    cells = {name: [row[index] for row in rows] for index, name in enumerate(columns)}
    check_stems(cells.get("file", []))
    check_views(cells.get("view", []), cells.get("tags", []))
    texts = {name: column for name, column in cells.items() if name in TEXT_COLUMNS}
    numbers = {name: _numbers(name, cells[name]) for name in cells if name not in texts}
    return Table(texts, numbers)


def write_renders(
    folder: Path, stems: Sequence[str], renders: Sequence[tuple[View, Tensor]]
) -> None:
    """Save render, truth, error map and mask of every view."""
    pairs = zip(stems, renders, strict=True)
    run_tasks([functools.partial(_write_view, folder, stem, *shown) for stem, shown in pairs])


def _write_view(folder: Path, stem: str, view: View, rgb: Tensor) -> None:
    render, truth = quantise(rgb), quantise(view.image)
    of_render, of_truth, of_error, of_mask = KINDS
    images = {of_render: render, of_truth: truth, of_error: error_map(render, truth)}
    if view.mask is not None:
        valid = view.mask.detach().cpu().numpy() > 0.5
        images[of_mask] = np.where(valid, 255, 0).astype(np.uint8)
    for kind, pixels in images.items():
        write_whole(folder / f"{stem}{kind}.png", png(pixels))


def remove_made_of_model(run_dir: Path) -> None:
    """Remove what commands made of the model that a training replaced, and nothing else."""
    derived = [run_dir / name for name in (VIEW, *VIDEOS)]
    derived += [run_dir / EXPORT / f"scene.{ending}" for ending in EXPORTED]
    derived += filter(is_rendered, (run_dir / PICTURES).glob("*.png"))
    for file in derived:
        if not file.is_dir():
            file.unlink(missing_ok=True)


def is_rendered(file: Path) -> bool:
    """Return whether `fishersplat render` wrote the picture."""
    from PIL import Image

    if not is_file(file):
        return False
    try:
        with Image.open(file) as image:
            return image.info.get(SOFTWARE) == WRITER
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False


def error_map(render: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """[H, W, 3] uint8 colours of the mean absolute difference of two [H, W, 3] uint8 images."""
    import cv2  # its map is matplotlib's to one level, and a run has no other use for that

    difference = np.abs(render.astype(np.float64) - truth.astype(np.float64)).mean(axis=2) / 255.0
    levels = np.minimum(256 / ERROR_SCALE * difference, 255).astype(np.uint8)
    return np.ascontiguousarray(cv2.applyColorMap(levels, cv2.COLORMAP_MAGMA)[..., ::-1])


def _finite(value: float | None) -> float | None:
    """None, an empty cell, for what the reader refuses."""
    return value if value is not None and abs(value) <= LARGEST else None


def _numbers(name: str, cells: Sequence[str]) -> np.ndarray:
    values = [float(cell) if cell else math.nan for cell in cells]
    for cell, value in zip(cells, values, strict=True):
        if cell and not name.startswith(LOGGED):  # those are the plugins' own, and not drawn
            check_number(name, value)
    return np.array(values, dtype=np.float64)


def png(pixels: np.ndarray, writer: str = "") -> bytes:
    """The content of a PNG file, which names its writer if there is one."""
    from PIL import Image, PngImagePlugin

    info, buffer = PngImagePlugin.PngInfo(), io.BytesIO()
    if writer:
        info.add_text(SOFTWARE, writer)
    # level 1 takes a third of the time of the default 6, for 4 % more bytes
    Image.fromarray(pixels).save(buffer, format="PNG", compress_level=1, pnginfo=info)
    return buffer.getvalue()


def photo_files(names: Sequence[str]) -> list[str]:
    """Return the photo files, inside a run's folder, of its training views `names` in order."""
    return [f"{PHOTOS}/{stem}.jpg" for stem in file_stems(names)]


def write_photos(run_dir: Path, training: Sequence[View]) -> None:
    """Write them."""
    files = [run_dir / name for name in photo_files([view.name for view in training])]
    pairs = zip(files, training, strict=True)
    run_tasks([functools.partial(_write, file, view) for file, view in pairs])


def _write(file: Path, view: View) -> None:
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(quantise(view.image)).save(buffer, "JPEG", quality=QUALITY, subsampling=0)
    write_whole(file, buffer.getvalue())
