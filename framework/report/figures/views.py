"""Which runs and test views a report shows pictures of, and their image files."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from framework.errors import require
from framework.files.paths import inside
from framework.records.run_files import RENDERS
from framework.report.statistics.numbers import average
from framework.report.study.methods import Method
from framework.report.study.study import ReportRun, Study
from framework.scenes.images import read_image

MOST_STRETCH = 40  # of a picture: one that is thinner would fill pages
EMBEDDED = "embedded"  # the name of the only scene whose pictures are ours


def shown_methods(study: Study, scene: str) -> list[Method]:
    """The methods with runs on a scene; of one with several budgets, the budget with the highest
    mean PSNR there, as all of them would fill pages."""
    best: dict[Method, tuple[float, Method]] = {}
    for method in study.methods:
        runs = study.of(scene, method)
        if runs:
            psnr = average([run.mean("psnr") for run in runs])
            rank = -math.inf if psnr is None else psnr
            if method.family not in best or rank > best[method.family][0]:
                best[method.family] = (rank, method)
    return [method for _, method in best.values()]


def choose_views(study: Study, scene: str) -> tuple[list[ReportRun], dict[str, str]]:
    """Choose the lowest seed that every shown method has, and up to three test views by mean PSNR.

    If views are tagged, these are the median view of each tag and the worst of all. Otherwise they
    are the best, the median and the worst.

    Returns:
        One run per method, and view -> why it was chosen.
    """
    present = [study.of(scene, method) for method in shown_methods(study, scene)]
    common = set.intersection(*({run.seed for run in runs} for runs in present))
    seeds = [min(common) if common else runs[0].seed for runs in present]
    pairs = zip(present, seeds, strict=True)
    chosen = [next(run for run in runs if run.seed == seed) for runs, seed in pairs]
    return chosen, _pick(chosen)


def image_file(run: ReportRun, view: str, kind: str) -> Path:
    """kind: render, truth or error. Raises UserError where that leads out of the run."""
    suffix = "" if kind == "render" else f"_{kind}"
    return inside(run.run.run_dir, f"{RENDERS}/{run.files[view]}{suffix}.png")


def picture(run: ReportRun, view: str, kind: str) -> np.ndarray:
    """[H, W, 3] uint8 of the file `image_file`. Raises UserError for another file."""
    file = image_file(run, view, kind)
    pixels = read_image(file)
    height, width = pixels.shape[:2]
    require(
        max(height, width) <= MOST_STRETCH * min(height, width),
        f"{file}: expected sides of at most 1:{MOST_STRETCH}, got {width}x{height}; run again",
    )
    return pixels


def psnr_text(run: ReportRun, view: str) -> str:
    """A view's PSNR as below a picture."""
    psnr = run.psnr[view]
    return "PSNR infinite" if math.isnan(psnr) else f"{psnr:.2f} dB"


def _pick(runs: Sequence[ReportRun]) -> dict[str, str]:
    """View -> why, for the views that all runs have."""
    common = set.intersection(*(set(run.psnr) for run in runs))
    mean = {view: _mean_psnr(runs, view) for view in runs[0].psnr if view in common}
    if not mean:
        return {}
    ranked = sorted(mean, key=lambda view: -mean[view])
    texts = runs[0].run.metrics.texts
    tags = {view: text.split() for view, text in zip(texts["view"], texts["tags"], strict=True)}
    wanted = []
    for tag in ("interpolating", "extrapolating"):
        tagged = [view for view in ranked if tag in tags[view]]
        if tagged:
            wanted.append((f"{tag}, median", tagged[len(tagged) // 2]))
    if not wanted:
        wanted = [("best", ranked[0]), ("median", ranked[len(ranked) // 2])]
    picked: dict[str, str] = {}
    for why, view in (*wanted, ("worst", ranked[-1])):
        picked[view] = f"{picked[view]}; {why}" if view in picked else why
    return picked


def _mean_psnr(runs: Sequence[ReportRun], view: str) -> float:
    values = [run.psnr[view] for run in runs]
    return float(np.mean([math.inf if math.isnan(psnr) else psnr for psnr in values]))


def own_scenes(study: Study) -> list[str]:
    """The scenes that are the repository's own, whose pictures anybody may have."""
    embedded = {run.scene for run in study.runs if run.record.config["scene"]["name"] == EMBEDDED}
    return [scene for scene in study.scenes if scene in embedded]
