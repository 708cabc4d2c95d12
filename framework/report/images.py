"""Image grids of a report: ground truth, renders and error maps of the same test views for every
method, with the same seed."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from framework.report.collect import ReportRun, Study
from framework.report.figures import STYLE, DrawnFigure, save, slug
from framework.run_files import ERROR_SCALE, RENDERS

PANEL_INCHES = 3.2
LABEL_CHARACTERS = 30


@dataclass(frozen=True)
class ShownViews:
    """What an image grid shows: one run per method, and (view, why it was chosen) pairs."""

    runs: tuple[ReportRun, ...]
    views: tuple[tuple[str, str], ...]


def draw_images(study: Study, scene: str) -> DrawnFigure:
    """Ground truth, render and error map of the same test views for every method."""
    shown = choose_views(study, scene)
    name = f"images_{slug(scene)}"
    columns, rows = 1 + len(shown.runs), 2 * len(shown.views)
    with matplotlib.rc_context(STYLE):
        aspect = _aspect(shown)
        size = (PANEL_INCHES * columns, (PANEL_INCHES * aspect + 0.25) * rows + 0.4)
        figure = Figure(figsize=size, layout="compressed")
        axes = figure.subplots(rows, columns, squeeze=False)
        for index, (view, why) in enumerate(shown.views):
            _draw_view(axes[2 * index : 2 * index + 2], shown.runs, view, why, index == 0)
        files = save(figure, study.study_dir, name, ("png",))
    return DrawnFigure("images", scene, files, _images_caption(shown))


def choose_views(study: Study, scene: str) -> ShownViews:
    """The lowest seed that every method has, and up to three test views by their mean PSNR over
    those runs: where views are tagged, the median one of each tag and the worst of all; else best,
    median and worst."""
    by_method = [study.of(scene, method) for method in study.methods]
    present = [runs for runs in by_method if runs]
    common = set.intersection(*({run.seed for run in runs} for runs in present))
    seeds = [min(common) if common else runs[0].seed for runs in present]
    chosen = tuple(
        next(run for run in runs if run.seed == seed)
        for runs, seed in zip(present, seeds, strict=True)
    )
    return ShownViews(chosen, tuple(_pick(chosen).items()))


def _pick(runs: Sequence[ReportRun]) -> dict[str, str]:
    """View -> why, for the views that all runs have."""
    tables = [run.run.metrics.set_index("view") for run in runs]
    # an infinite PSNR is stored as missing
    psnr = pd.concat([table["psnr"].fillna(np.inf) for table in tables], axis=1, join="inner")
    mean = psnr.mean(axis=1).sort_values(kind="stable", ascending=False)
    tags = tables[0]["tags"].reindex(mean.index)
    wanted: list[tuple[str, pd.Series]] = []
    for tag in ("interpolating", "extrapolating"):
        tagged = mean[tags.map(str.split).map(lambda own, tag=tag: tag in own)]
        if len(tagged):
            wanted.append((f"{tag}, median", tagged.iloc[[len(tagged) // 2]]))
    if not wanted:
        wanted = [("best", mean.iloc[[0]]), ("median", mean.iloc[[len(mean) // 2]])]
    wanted.append(("worst", mean.iloc[[-1]]))
    picked: dict[str, str] = {}
    for why, entry in wanted:
        view = str(entry.index[0])
        picked[view] = f"{picked[view]}; {why}" if view in picked else why
    return picked


def _draw_view(
    axes: np.ndarray, runs: Sequence[ReportRun], view: str, why: str, first: bool
) -> None:
    """Two rows: truth and renders, colour scale and error maps."""
    for column, run in enumerate(runs, start=1):
        row = run.run.metrics.set_index("view").loc[view]
        folder = run.run.run_dir / RENDERS
        if column == 1:
            _show(axes[0, 0], folder / f"{row['file']}_truth.png", "ground truth" if first else "")
            axes[0, 0].set_ylabel(f"{view}\n{why}")
            _draw_scale(axes[1, 0])
        label = textwrap.fill(run.method, LABEL_CHARACTERS) + "\n" if first else ""
        psnr = "PSNR infinite" if np.isnan(row["psnr"]) else f"{row['psnr']:.2f} dB"
        _show(axes[0, column], folder / f"{row['file']}.png", f"{label}{psnr}")
        _show(axes[1, column], folder / f"{row['file']}_error.png", "")


def _show(axes: Axes, path: Path, title: str) -> None:
    with Image.open(path) as image:
        axes.imshow(np.asarray(image))
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_title(title, fontsize=9)


def _draw_scale(axes: Axes) -> None:
    """The error maps' colour scale, in the cell beside them."""
    axes.set_axis_off()
    inset = axes.inset_axes((0.1, 0.45, 0.8, 0.1))
    inset.imshow(np.linspace(0, 1, 256)[None], aspect="auto", cmap="magma", extent=(0, 1, 0, 1))
    inset.set_yticks([])
    inset.set_xticks([0, 0.5, 1], ["0", f"{ERROR_SCALE / 2:g}", f"≥ {ERROR_SCALE:g}"])
    inset.set_title("mean absolute error", fontsize=9)


def _images_caption(shown: ShownViews) -> str:
    seeds = sorted({run.seed for run in shown.runs})
    seed = f"seed {seeds[0]}" if len(seeds) == 1 else "each method's lowest seed (none is common)"
    views = "; ".join(f"{view} ({why})" for view, why in shown.views)
    return (
        f"Ground truth, renders with their PSNR, and error maps below them; {seed}. The views are"
        f" the same for every method, chosen by their mean PSNR over the methods: {views}. Error:"
        f" mean absolute difference over the channels, black = 0, pale yellow = {ERROR_SCALE:g} or"
        " more."
    )


def _aspect(shown: ShownViews) -> float:
    """Height / width of the first image shown."""
    run, view = shown.runs[0], shown.views[0][0]
    stem = str(run.run.metrics.set_index("view").loc[view, "file"])
    with Image.open(run.run.run_dir / RENDERS / f"{stem}_truth.png") as image:
        return image.height / image.width
