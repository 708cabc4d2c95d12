"""Pictures of a scene: a close-up of all methods.

The close-up shows the median view by PSNR, not the one with the largest difference. The crop is the
window with the largest variance over the methods, averaged over the window.
"""

from collections.abc import Sequence

import numpy as np

from framework.errors import require
from framework.files.whole import write_whole
from framework.records.run_files import ERROR_SCALE
from framework.report.figures.chart import Picture
from framework.report.figures.grid import Cell, draw_grid
from framework.report.figures.views import choose_views, image_file, picture, psnr_text
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import listed, outside

CLOSEUP = "closeup"  # begins the names of pictures
SHARE = 4  # of the width and height that a crop takes: one part in so many


def draw_closeup(study: Study, scene: str) -> Picture | None:
    """Draw ground truth, render, crop and error map of one test view for every method.

    Returns None if the methods have no test view in common."""
    runs, views = choose_views(study, scene)
    if not views:
        return None
    view, why = [pair for pair in views.items() if "median" in pair[1]][-1]
    truth = picture(runs[0], view, "truth")
    renders, errors = (
        [_of_size(truth, run, view, kind) for run in runs] for kind in ("render", "error")
    )
    window = _window(renders if len(renders) > 1 else [truth, *renders])
    names = [f"{run.method}\n{psnr_text(run, view)}" for run in runs]
    rows = []
    per_row = 3 if len(names) == 3 else 2
    for k in range(0, len(names), per_row):
        part = slice(k, k + per_row)
        pictures = [truth, *renders[part]]
        titles = ["ground truth", *names[part]]
        rows += [
            [Cell(title, p, window) for title, p in zip(titles, pictures, strict=True)],
            [Cell("", p[window]) for p in pictures],
            [Cell("", truth[:0]), *(Cell("error", error) for error in errors[part])],
        ]
    name = f"{study.file_of(CLOSEUP, scene)}.jpg"
    write_whole(study.out_dir / name, draw_grid(f"{scene}: {outside(view)}", rows, ERROR_SCALE))
    reason = "the only one" if len(views) == 1 else why.replace("; ", " and ")
    seeds = listed(sorted({run.seed for run in runs}))
    caption = (
        f"Test view {outside(view)} ({reason} by PSNR), seed {seeds}: ground truth and renders with"
        " their PSNR; the framed part, where the renders of all methods differ most; error maps"
        f" (mean absolute difference over the channels, black = 0, pale yellow = {ERROR_SCALE:g} or"
        " more)."
    )
    return Picture((name,), f"All methods on {scene}", caption)


def _of_size(truth: np.ndarray, run: ReportRun, view: str, kind: str) -> np.ndarray:
    """A picture of the size of the photo. Raises UserError for another one."""
    pixels = picture(run, view, kind)
    height, width = truth.shape[:2]
    require(
        pixels.shape == truth.shape,
        f"{image_file(run, view, kind)}: expected {width}x{height} as the photo, got"
        f" {pixels.shape[1]}x{pixels.shape[0]}; run again, or remove the run's folder",
    )
    return pixels


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


def remove_pictures(study: Study, scenes: Sequence[str]) -> None:
    """Remove the pictures of an earlier report, except those of these scenes."""
    kept = {f"{study.file_of(CLOSEUP, scene)}.jpg" for scene in scenes}
    for path in study.out_dir.glob(f"{CLOSEUP}_*.jpg"):
        if path.name not in kept and not path.is_dir():
            path.unlink()
