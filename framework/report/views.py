"""Which runs and test views a report shows pictures of, and their image files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from framework.paths import inside
from framework.report.collect import ReportRun, Study
from framework.run_files import RENDERS


@dataclass(frozen=True)
class ShownViews:
    """What an image grid shows: one run per method, and (view, why it was chosen) pairs."""

    runs: tuple[ReportRun, ...]
    views: tuple[tuple[str, str], ...]


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


def image_file(run: ReportRun, view: str, kind: str) -> Path:
    """kind: `render`, `truth` or `error`. Raises UserError where that leads out of the run."""
    suffix = "" if kind == "render" else f"_{kind}"
    return inside(run.run.run_dir, f"{RENDERS}/{run.files[view]}{suffix}.png")


def psnr_of(run: ReportRun, view: str) -> float | None:
    """A view's PSNR in dB; None where it is infinite."""
    return None if np.isnan(run.psnr[view]) else run.psnr[view]


def _pick(runs: Sequence[ReportRun]) -> dict[str, str]:
    """View -> why, for the views that all runs have."""
    tables = [run.run.metrics.set_index("view") for run in runs]
    # an infinite PSNR is stored as missing
    psnr = pd.concat([table["psnr"].fillna(np.inf) for table in tables], axis=1, join="inner")
    mean = psnr.mean(axis=1).sort_values(kind="stable", ascending=False)
    if mean.empty:
        return {}
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
