"""The chart of test PSNR over the training time of each method."""

from __future__ import annotations

import math
from collections.abc import Sequence

from framework.options import members_of
from framework.report.figures.views import shown_methods
from framework.report.parts.chart import MIN_SPAN_DB, Chart, Point, Series
from framework.report.parts.palette import looks
from framework.report.statistics.estimates import spread
from framework.report.study.runs import ReportRun, Study

THIN_SEEDS = 12
Evaluations = dict[int, tuple[float, float]]  # step -> seconds, test PSNR (dB)
CAPTION = (
    "Test PSNR at the evaluation steps against training seconds. Bold: mean over seeds of both at"
    " equal steps, with the 95 % interval of the mean PSNR; thin: single seeds,"
    f" the first {THIN_SEEDS} of many."
)

MEMBERS = (
    " The trainings of a run with several members follow each other: quality falls where the next"
    " begins, and the last point is that of the joined Gaussians."
)


def caption(study: Study, scene: str) -> str:
    """What the chart shows, of members too where a run has some."""
    several = False
    for run in study.of(scene):
        trainer, scene_info = run.record.config["trainer"], run.record.scene
        views = len(scene_info.training) if scene_info else 1
        several |= members_of(trainer.get("members", 1), trainer["steps"], views) > 1
    return CAPTION + (MEMBERS if several else "")


def chart(study: Study, scene: str) -> Chart | None:
    """None where no history of the scene has an evaluation."""
    series: list[Series] = []
    given = looks(study.families)
    for method in shown_methods(study, scene):
        found = study.of(scene, method)
        look = given[found[0].method_label.family]
        runs = [table for run in found if len(table := evaluations(run))]
        if runs:
            series += _series(method, look, runs)
    if not series:
        return None
    label = "training time (s, wall clock, without evaluation)"
    return Chart(
        study.file_of("curves", scene),
        scene,
        label,
        "test PSNR (dB)",
        tuple(series),
        min_span=MIN_SPAN_DB,
    )


def _series(method: str, look: int, runs: Sequence[Evaluations]) -> list[Series]:
    thin = []
    if len(runs) > 1:
        for run in runs[:THIN_SEEDS]:
            points = tuple(Point(x, y, y, y) for x, y in run.values())
            thin.append(Series(method, look, points, faint=True))
    # a mean over fewer seeds at some steps would bend the curve
    steps = sorted(set(runs[0]).intersection(*runs))
    mean = tuple(_mean_point(step, [run[step] for run in runs]) for step in steps)
    return [*thin, Series(f"{method} (n = {len(runs)})", look, mean)] if mean else thin


def _mean_point(step: int, pairs: Sequence[tuple[float, float]]) -> Point:
    found = spread([psnr for _, psnr in pairs])
    seconds = sum(second for second, _ in pairs) / len(pairs)
    return Point(seconds, found.mean, *found.ends, f"step {step}")


def evaluations(run: ReportRun) -> Evaluations:
    """Of a run, where it was tested during training."""
    history = run.run.history.numbers
    rows = zip(history["step"], history["seconds"], history["test_psnr"], strict=True)
    return {int(step): (float(s), float(psnr)) for step, s, psnr in rows if not math.isnan(psnr)}
