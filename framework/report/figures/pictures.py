"""Pictures of a scene: a close-up of all methods.

The close-up shows the median view by PSNR, not the one with the largest difference. The crop is the
window with the largest variance over the methods, averaged over the window.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from framework.errors import require
from framework.files.whole import write_whole
from framework.records.run_files import ERROR_SCALE
from framework.report.figures.chart import Picture
from framework.report.figures.grid import COLUMNS, Band, Cell, draw_band
from framework.report.figures.views import choose_views, image_file, picture, psnr_text
from framework.report.study.study import Study
from framework.report.study.words import listed, outside

CLOSEUP = "closeup"  # begins the names of pictures
SHARE = 4  # of the width and height that a crop takes: one part in so many
FRAME = np.array([255, 215, 0], dtype=np.uint8)
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
            size = pictures[-1].shape
            require(
                size == truth.shape,
                f"{image_file(run, view, kind)}: expected {truth.shape[1]}x{truth.shape[0]} as the"
                f" photo, got {size[1]}x{size[0]}; run again, or remove the run's folder",
            )
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
    band = Band(f"{scene}: {outside(view)}", tuple(groups), ERROR_SCALE)
    reason = "the only one" if len(shown.views) == 1 else why.replace("; ", " and ")
    seeds = listed(sorted({run.seed for run in shown.runs}))
    caption = (
        f"Test view {outside(view)} ({reason} by PSNR), seed {seeds}: ground truth and renders with"
        " their PSNR; the framed part, where the renders of all methods differ most; error maps"
        f" (mean absolute difference over the channels, black = 0, pale yellow = {ERROR_SCALE:g} or"
        " more)."
    )
    name, buffer = f"{study.file_of(CLOSEUP, scene)}.jpg", io.BytesIO()
    draw_band(band).save(buffer, format="JPEG", **JPEG)
    write_whole(study.out_dir / name, buffer.getvalue())
    return Picture((name,), f"All methods on {scene}", caption)


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


def remove_pictures(study: Study, scenes: Sequence[str]) -> None:
    """Remove the pictures of an earlier report, except those of these scenes."""
    kept = {f"{study.file_of(CLOSEUP, scene)}.jpg" for scene in scenes}
    for path in study.out_dir.glob(f"{CLOSEUP}_*.jpg"):
        if path.name not in kept and not path.is_dir():
            path.unlink()
