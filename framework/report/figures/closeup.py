"""The picture of a scene that answers first: truth, two methods, and a crop of where methods differ
most.

The view is the median by PSNR, not the one with the largest difference; the crop is the window
where the renders of all methods vary most (variance over the methods, mean over the window).
"""

from __future__ import annotations

import numpy as np

from framework.records.run_files import ERROR_SCALE
from framework.report.figures.files import grid_picture
from framework.report.figures.views import check_size, choose_views, picture, psnr_text
from framework.report.parts.document import Picture
from framework.report.parts.grid import Band, Cell, Scale
from framework.report.study.labels import outside
from framework.report.study.runs import Study

SHARE = 4  # of the width and height that a crop takes: one part in so many
FRAME = np.array([255, 215, 0], dtype=np.uint8)
CAPTION = (
    "Test view {view} ({why} by PSNR) with seed {seed}: ground truth, then {methods}. Below: the"
    " framed part, where the renders of all methods of the report differ most, and the error"
    " maps (mean absolute difference over the channels, black = 0)."
)


def draw_closeup(study: Study, scene: str, families: tuple[str, ...]) -> Picture | None:
    """families: of at most two methods to show beside the truth, as far as they ran there."""
    shown = choose_views(study, scene)
    runs = [run for name in families for run in shown.runs if run.method_label.family == name]
    runs = runs or list(shown.runs[:2])
    if not shown.views:
        return None
    view, why = [pair for pair in shown.views if "median" in pair[1]][-1]
    truth = picture(runs[0], view, "truth")
    for run in (*runs, *shown.runs):
        for kind in ("render", "error"):
            check_size(run, view, picture(run, view, kind).shape, truth.shape)
    renders = [picture(run, view, "render") for run in runs]
    every = [picture(run, view, "render") for run in shown.runs]
    window = _window(every if len(every) > 1 else [truth, *every])
    names = ["ground truth", *(f"{run.method}\n{psnr_text(run, view)}" for run in runs)]
    pictures = [truth, *renders]
    whole = [Cell(n, _framed(p, window)) for n, p in zip(names, pictures, strict=True)]
    parts = [Cell("", np.ascontiguousarray(picture[window])) for picture in pictures]
    errors = [Cell("", np.full_like(truth, 255))]  # of the truth: an empty place
    errors += [Cell(f"error: {run.method}", picture(run, view, "error")) for run in runs]
    scale = Scale("mean absolute error", "magma", ERROR_SCALE)
    band = Band(f"{scene}: {outside(view)}", (tuple(whole), tuple(parts), tuple(errors)), scale)
    seeds = sorted({run.seed for run in runs})
    caption = CAPTION.format(
        view=outside(view),
        why="the only one" if len(shown.views) == 1 else why.replace("; ", " and "),
        seed=" and ".join(map(str, seeds)),
        methods=" and ".join(run.method for run in runs),
    )
    name, alt = study.file_of("closeup", scene), f"Truth and methods close up on {scene}"
    return grid_picture(study.out_dir, name, [band], alt, caption, in_viewer=False)


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
    for edge in (
        (slice(rows.start, rows.start + thick), columns),
        (slice(rows.stop - thick, rows.stop), columns),
        (rows, slice(columns.start, columns.start + thick)),
        (rows, slice(columns.stop - thick, columns.stop)),
    ):
        framed[edge] = FRAME
    return framed
