"""The chart of test PSNR over the training time of each method."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from framework.report.chart import Chart, Point, Series
from framework.report.collect import ReportRun, Study
from framework.report.labels import slug
from framework.report.statistics import spread

CAPTION = (
    "Test PSNR at the evaluation steps against training seconds. Bold: mean over seeds of both at"
    " equal steps, with the 95 % interval of the mean PSNR; thin: single seeds."
)


def chart(study: Study, scene: str) -> Chart | None:
    """None where no history of the scene has an evaluation."""
    series: list[Series] = []
    for index, method in enumerate(study.methods):
        runs = [table for run in study.of(scene, method) if len(table := _evaluations(run))]
        if runs:
            series += _series(method, index, runs)
    if not series:
        return None
    label = "training time (s, wall clock, without evaluation)"
    return Chart(f"curves_{slug(scene)}", scene, label, "test PSNR (dB)", tuple(series))


def _series(method: str, index: int, runs: Sequence[pd.DataFrame]) -> list[Series]:
    thin = []
    if len(runs) > 1:
        for run in runs:
            seconds, psnr = run["seconds"].tolist(), run["test_psnr"].tolist()
            points = tuple(Point(x, y, y, y) for x, y in zip(seconds, psnr, strict=True))
            thin.append(Series(method, index, points, faint=True))
    grouped = pd.concat(runs).groupby("step")
    # a mean over fewer seeds at some steps would bend the curve
    whole = [(step, group) for step, group in grouped if len(group) == len(runs)]
    mean = tuple(_mean_point(int(str(step)), group) for step, group in whole)
    return [*thin, Series(f"{method} (n = {len(runs)})", index, mean)] if mean else thin


def _mean_point(step: int, group: pd.DataFrame) -> Point:
    found = spread(group["test_psnr"].tolist())
    low = high = found.mean
    if found.mean_interval is not None:
        low, high = found.mean_interval.low, found.mean_interval.high
    return Point(float(group["seconds"].mean()), found.mean, low, high, f"step {step}")


def _evaluations(run: ReportRun) -> pd.DataFrame:
    history = run.run.history
    return history.loc[history["test_psnr"].notna(), ["step", "seconds", "test_psnr"]]
