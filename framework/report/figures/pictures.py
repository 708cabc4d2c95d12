"""Pictures of a scene: a close-up of all methods, and maps of where the runs of one method differ.

The close-up shows the median view by PSNR, not the one with the largest difference. The crop is the
window with the largest variance over the methods, averaged over the window. A map shows the
standard deviation (n - 1) over seeds of each pixel of the 8-bit renders. It is the root mean square
over the channels, in units of the full range.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

from framework.files.whole import write_whole
from framework.records.run_files import ERROR_SCALE
from framework.report.figures.chart import Picture
from framework.report.figures.grid import COLUMNS, Band, Cell, Scale, draw_bands
from framework.report.figures.views import check_size, choose_views, picture, psnr_text
from framework.report.statistics.numbers import format_significant
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import listed, outside

KINDS = ("closeup", "sigma", "images")  # begin the names of pictures; older reports used the last
SHARE = 4  # of the width and height that a crop takes: one part in so many
FRAME = np.array([255, 215, 0], dtype=np.uint8)
SIGMA_SCALE, SIGMA_COLORS = 0.1, "viridis"
FEWEST_SEEDS = 3  # a deviation of two values says little about a pixel
BESIDE = COLUMNS - 1  # methods in a row, after the ground truth
JPEG: dict[str, Any] = {"quality": 90, "subsampling": 0}  # colour edges of maps stay sharp


def draw_closeup(study: Study, scene: str) -> Picture | None:
    """Ground truth, render, crop and error map of one test view for every method; None without a
    view that all have."""
    shown = choose_views(study, scene)
    if not shown.views:
        return None
    view, why = [pair for pair in shown.views if "median" in pair[1]][-1]
    truth = picture(shown.runs[0], view, "truth")
    renders: list[np.ndarray] = []
    errors: list[np.ndarray] = []
    for run in shown.runs:
        for kind, pictures in (("render", renders), ("error", errors)):
            pictures.append(picture(run, view, kind))
            check_size(run, view, pictures[-1].shape, truth.shape)
    window = _window(renders if len(renders) > 1 else [truth, *renders])
    groups: list[tuple[Cell, ...]] = []
    for k in range(0, len(shown.runs), BESIDE):
        runs, pictures = shown.runs[k : k + BESIDE], [truth, *renders[k : k + BESIDE]]
        names = ["ground truth", *(f"{run.method}\n{psnr_text(run, view)}" for run in runs)]
        empty = Cell("", np.full_like(truth, 255))
        groups += [
            tuple(Cell(n, _framed(p, window)) for n, p in zip(names, pictures, strict=True)),
            tuple(Cell("", np.ascontiguousarray(p[window])) for p in pictures),
            (empty, *(Cell("error", error) for error in errors[k : k + BESIDE])),
        ]
    scale = Scale("mean absolute error", "magma", ERROR_SCALE)
    band = Band(f"{scene}: {outside(view)}", tuple(groups), scale)
    reason = "the only one" if len(shown.views) == 1 else why.replace("; ", " and ")
    seeds = listed(sorted({run.seed for run in shown.runs}))
    caption = (
        f"Test view {outside(view)} ({reason} by PSNR), seed {seeds}: ground truth and renders with"
        " their PSNR; the framed part, where the renders of all methods differ most; error maps"
        f" (mean absolute difference over the channels, black = 0, pale yellow = {ERROR_SCALE:g} or"
        " more)."
    )
    name = study.file_of("closeup", scene)
    return _grid_picture(study.out_dir, name, [band], f"All methods on {scene}", caption)


def _window(pictures: list[np.ndarray]) -> tuple[slice, slice]:
    """Rows and columns of the window where the pictures [H, W, 3] vary most between each other."""
    stack = np.stack([picture.astype(np.int64) for picture in pictures])
    # n^2 times the variance, in integers: exact on every machine
    n = len(stack)
    varies = (n * (stack**2).sum(axis=0) - stack.sum(axis=0) ** 2).sum(axis=2)
    height, width = (max(1, size // SHARE) for size in varies.shape)
    sums = np.zeros((varies.shape[0] + 1, varies.shape[1] + 1), dtype=np.int64)
    sums[1:, 1:] = varies.cumsum(axis=0).cumsum(axis=1)
    inside = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width]
    inside = inside + sums[:-height, :-width]
    top, left = np.unravel_index(int(inside.argmax()), inside.shape)
    return slice(int(top), int(top) + height), slice(int(left), int(left) + width)


def _framed(picture: np.ndarray, window: tuple[slice, slice]) -> np.ndarray:
    """With a frame around the window."""
    rows, columns = window
    thick = max(1, picture.shape[1] // 160)
    framed = picture.copy()
    framed[rows, columns] = FRAME
    inner = (
        slice(rows.start + thick, rows.stop - thick),
        slice(columns.start + thick, columns.stop - thick),
    )
    framed[inner] = picture[inner]
    return framed


def draw_sigma_maps(study: Study, scene: str) -> Picture | None:
    """Where the runs of each method differ; None if no method has `FEWEST_SEEDS` seeds."""
    shown = choose_views(study, scene)
    groups = [(run.method, study.of(scene, run.method)) for run in shown.runs]
    groups = [(method, runs) for method, runs in groups if len(runs) >= FEWEST_SEEDS]
    if not groups or not shown.views:
        return None
    bands = []
    for view, why in shown.views:
        truth = Cell("ground truth", picture(shown.runs[0], view, "truth"))
        scale = Scale("standard deviation over seeds", SIGMA_COLORS, SIGMA_SCALE)
        maps = [_sigma_cell(str(method), runs, view) for method, runs in groups]
        bands.append(Band(f"{outside(view)} ({why})", ((truth, *maps),), scale))
    caption = (
        "Standard deviation of each pixel over the seeds of one method, root mean square over the"
        f" channels; dark = 0, yellow = {SIGMA_SCALE:g} of the full range or more. Below each name:"
        " root mean square over the pixels and the number of seeds."
    )
    name = study.file_of("sigma", scene)
    return _grid_picture(study.out_dir, name, bands, f"Deviation over seeds of {scene}", caption)


def sigma_map(runs: Sequence[ReportRun], view: str) -> np.ndarray:
    """Standard deviation (n - 1) over the runs [H, W], as root mean square over the channels.

    The renders are in [0, 1].
    """
    total = squares = np.zeros(1)
    for run in runs:
        pixels = picture(run, view, "render").astype(np.float64)
        if run is not runs[0]:
            check_size(run, view, pixels.shape, total.shape)
        total, squares = total + pixels, squares + pixels**2
    n = len(runs)
    variance = np.maximum(squares - total**2 / n, 0.0) / (n - 1)
    return np.sqrt(variance.mean(axis=2)) / 255.0


def _sigma_cell(method: str, runs: Sequence[ReportRun], view: str) -> Cell:
    having = [run for run in runs if view in run.files]
    sigma = sigma_map(having, view)
    rms = float(np.sqrt((sigma**2).mean()))
    colours = matplotlib.colormaps[SIGMA_COLORS](np.clip(sigma / SIGMA_SCALE, 0, 1), bytes=True)
    title = f"{method}\nrms {format_significant(rms)} (n = {len(having)})"
    return Cell(title, np.ascontiguousarray(colours[..., :3]))


def _grid_picture(
    out_dir: Path, name: str, bands: Sequence[Band], alt: str, caption: str
) -> Picture:
    """Draw the bands into a JPEG."""
    buffer = io.BytesIO()
    draw_bands(bands).save(buffer, format="JPEG", **JPEG)
    write_whole(out_dir / f"{name}.jpg", buffer.getvalue())
    return Picture((f"{name}.jpg",), alt, caption)


def remove_pictures(study: Study, scenes: Sequence[str]) -> None:
    """Remove the pictures of an earlier report, except those of these scenes."""
    kept = {f"{study.file_of(kind, scene)}.jpg" for kind in KINDS for scene in scenes}
    for kind in KINDS:
        for path in study.out_dir.glob(f"{kind}_*.jpg"):
            if path.name not in kept and not path.is_dir():
                path.unlink()
