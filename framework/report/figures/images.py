"""Pictures of a report: renders and error maps beside the ground truth, with one seed for every
method; and maps of where the runs of one method disagree.

Disagreement is the standard deviation (n - 1) over seeds of each pixel of the 8-bit renders, root
mean square over the channels, in units of the full range.
"""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
import numpy as np

from framework.records.run_files import ERROR_SCALE
from framework.report.figures.files import grid_picture
from framework.report.figures.views import (
    ShownViews,
    check_size,
    choose_views,
    picture,
    psnr_text,
    shown_methods,
)
from framework.report.parts.document import Picture
from framework.report.parts.grid import COLUMNS, Band, Cell, Scale
from framework.report.statistics.numbers import significant
from framework.report.study.labels import outside
from framework.report.study.runs import ReportRun, Study

KINDS = ("images", "sigma", "closeup")  # begin the names of files of photos and renders
SIGMA_SCALE, SIGMA_COLORS = 0.1, "viridis"
BESIDE = COLUMNS - 1  # methods beside the ground truth, each above its own error
FEWEST_SEEDS = 3  # a deviation of two values says little about a pixel


def draw_images(study: Study, scene: str) -> Picture | None:
    """Ground truth, render and error map of the same test views for every method."""
    shown = choose_views(study, scene)
    if not shown.views:
        return None
    bands = []
    for view, why in shown.views:
        truth = Cell("ground truth", picture(shown.runs[0], view, "truth"))
        nothing = Cell("", np.full_like(truth.pixels, 255))
        groups = []
        for first in range(0, len(shown.runs), BESIDE):
            runs = shown.runs[first : first + BESIDE]
            renders = [
                Cell(f"{run.method}\n{psnr_text(run, view)}", picture(run, view, "render"))
                for run in runs
            ]
            errors = [Cell(f"error: {run.method}", picture(run, view, "error")) for run in runs]
            groups += [(truth, *renders), (nothing, *errors)]
        scale = Scale("mean absolute error", "magma", ERROR_SCALE)
        bands.append(Band(f"{outside(view)} ({why})", tuple(groups), scale))
    name, caption = study.file_of("images", scene), _images_caption(shown)
    return grid_picture(study.out_dir, name, bands, f"Images of {scene}", caption, in_viewer=True)


def remove_pictures(study: Study, scenes: Sequence[str]) -> None:
    """Remove what an earlier report drew, perhaps under other names, but that of these scenes."""
    kept = {f"{study.file_of(kind, scene)}.jpg" for kind in KINDS for scene in scenes}
    for kind in KINDS:
        for path in study.out_dir.glob(f"{kind}_*.jpg"):
            if path.name not in kept and not path.is_dir():
                path.unlink()


def draw_sigma_maps(study: Study, scene: str) -> Picture | None:
    """Where the runs of each method disagree; None where no method has `FEWEST_SEEDS` seeds."""
    shown = choose_views(study, scene)
    groups = [
        (method, runs)
        for method in shown_methods(study, scene)
        if len(runs := study.of(scene, method)) >= FEWEST_SEEDS
    ]
    if not groups or not shown.views:
        return None
    bands = []
    for view, why in shown.views:
        truth = Cell("ground truth", picture(shown.runs[0], view, "truth"))
        scale = Scale("standard deviation over seeds", SIGMA_COLORS, SIGMA_SCALE)
        maps = [_sigma_cell(method, runs, view) for method, runs in groups]
        bands.append(Band(f"{outside(view)} ({why})", ((truth, *maps),), scale))
    caption = (
        "Where the runs of one method disagree: standard deviation of each pixel over the seeds,"
        f" root mean square over the channels; dark = 0, yellow = {SIGMA_SCALE:g} of the full range"
        " or more. Below each name: root mean square over the pixels and the number of seeds."
    )
    name, alt = study.file_of("sigma", scene), f"Deviation over seeds of {scene}"
    return grid_picture(study.out_dir, name, bands, alt, caption, in_viewer=False)


def sigma_map(runs: Sequence[ReportRun], view: str) -> np.ndarray:
    """[H, W] float64: standard deviation (n - 1) over the runs, root mean square over channels, of
    the renders in [0, 1]."""
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
    title = f"{method}\nrms {significant(rms)} (n = {len(having)})"
    return Cell(title, np.ascontiguousarray(colours[..., :3]))


def _images_caption(shown: ShownViews) -> str:
    seeds = sorted({run.seed for run in shown.runs})
    seed = f"seed {seeds[0]}" if len(seeds) == 1 else "each method's lowest seed (none is common)"
    views = "; ".join(f"{outside(view)} ({why})" for view, why in shown.views)
    return (
        f"Ground truth, renders with their PSNR, and error maps below them; {seed}. The views are"
        f" the same for every method, chosen by their mean PSNR over the methods: {views}. Error:"
        f" mean absolute difference over the channels, black = 0, pale yellow = {ERROR_SCALE:g} or"
        " more."
    )
