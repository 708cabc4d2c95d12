"""The tables of a report, as rows of text by heading. A value that is missing shows as `–` and its
reason is listed in the report. A mean carries ± half the width of its 95 % interval."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from framework.metrics.values import digits
from framework.report.parts.document import Link
from framework.report.statistics.numbers import ABSENT, mean_text, sigma_text
from framework.report.statistics.outcomes import seed_means
from framework.report.statistics.robustness import failure_rate, worst_case
from framework.report.study.beside import folder_target, video_link, view_link
from framework.report.study.labels import outside
from framework.report.study.names import LPIPS, heading_of, own_metrics
from framework.report.study.roles import marked
from framework.report.study.runs import ReportRun, Study

ALL_SCENES = "mean of all"

Rows = list[dict[str, str]]


def main_rows(study: Study, scenes: Sequence[str]) -> Rows:
    """One row per scene and method, and over all `scenes` where there are several."""
    groups = [(scene, [scene]) for scene in scenes]
    tested = [scene for scene in scenes if scene in study.tested]
    if len(tested) > 1:
        groups.append((ALL_SCENES, tested))
    rows = []
    for label, members in groups:
        shown_as = label if label == ALL_SCENES else marked(label, study.name_of(label))
        for method in study.methods:
            runs = [run for run in study.of(method=method) if run.scene in members]
            if runs:
                rows.append({"Scene": shown_as} | _main_row(study, method, runs, members))
    return rows if len(groups) > 1 else _without(rows, "Scene")


def worst_rows(study: Study) -> Rows:
    """The worst case of every method on every scene, and its failures."""
    rows = []
    scenes = study.tested if study.runs else sorted({run.scene for run in study.failed})
    for scene in scenes:
        for method in study.tried:
            rate = failure_rate(study, method, scene)
            if rate is not None:
                row = {"Scene": scene, "Method": method} | _worst_cells(study.of(scene, method))
                share = f"{rate.failed} of {rate.n}"
                low, high = (f"{100 * end:.0f}" for end in (rate.interval.low, rate.interval.high))
                rows.append(row | {"Failed runs": f"{share} [{low} to {high} %]"})
    return rows if len(scenes) > 1 else _without(rows, "Scene")


def tags_of(study: Study, scene: str) -> list[str]:
    """The tags that mark some test views of a scene, `interpolating` before `extrapolating`."""
    texts = {text for run in study.of(scene) for text in run.run.metrics.texts["tags"]}
    tags = {tag for text in texts for tag in text.split()}
    return sorted(tags, key=lambda tag: (tag != "interpolating", tag))


def tag_rows(study: Study, scenes: Sequence[str]) -> Rows:
    """PSNR and SSIM of the test views with each tag: mean over the views, then over the seeds."""
    rows = []
    for scene in scenes:
        for method in study.methods:
            runs = study.of(scene, method)
            row = {"Scene": scene, "Method": method}
            for tag in tags_of(study, scene) if runs else []:
                for metric in ("psnr", "ssim"):
                    values = [_tag_mean(run, tag, metric) for run in runs]
                    heading = f"{heading_of(metric)}, {outside(tag)}"
                    row[heading] = mean_text(values, digits(metric), show_half=metric == "psnr")
            if len(row) > 2:
                rows.append(row)
    return rows if len(scenes) > 1 else _without(rows, "Scene")


def seed_rows(study: Study) -> list[dict[str, str | Link]]:
    """One row per run."""
    metrics = measured(study)
    return [_seed_row(study, run, metrics) for run in study.runs]


def measured(study: Study) -> list[str]:
    """The metrics of the main table: LPIPS only where some run has it, none where nothing was
    tested."""
    if study.runs and not study.tested:
        return []
    found = [m for m in LPIPS if any(run.mean(m) is not None for run in study.runs)]
    return ["psnr", "ssim", "flip", *found, *own_metrics(study)]


def _main_row(
    study: Study, method: str, runs: list[ReportRun], scenes: list[str]
) -> dict[str, str]:
    row, n_seeds = {"Method": method}, len(seed_means(runs, scenes))
    for metric in measured(study):
        values = list(seed_means(runs, scenes, metric).values())
        told = mean_text(values, digits(metric), show_half=metric == "psnr")
        fewer = 0 < len(values) < n_seeds  # measured in some runs alone
        row[heading_of(metric, study)] = f"{told} (n = {len(values)})" if fewer else told
        if metric == "psnr":
            row["σ_PSNR (dB)"] = sigma_text(values)
    row["Train (s)"] = mean_text([run.record.train_s for run in runs], 1)
    row["CPU (s)"] = mean_text([run.record.train_cpu_s for run in runs], 1)
    row["Gaussians"] = mean_text([float(run.record.gaussians) for run in runs], 0)
    row["Parameters (k)"] = mean_text([run.record.parameters / 1000 for run in runs], 0)
    return row


def _worst_cells(runs: list[ReportRun]) -> dict[str, str]:
    worst = worst_case(runs)
    if worst is None:
        headings = ("Worst seed (dB)", "Worst view (dB)", "5th percentile of views (dB)")
        return dict.fromkeys(headings, ABSENT)
    return {
        "Worst seed (dB)": f"{worst.run_psnr:.2f} (seed {worst.run_seed})",
        "Worst view (dB)": f"{worst.view_psnr:.2f} ({outside(worst.view)}, seed {worst.view_seed})",
        "5th percentile of views (dB)": f"{worst.percentile:.2f}",
    }


def _tag_mean(run: ReportRun, tag: str, metric: str) -> float | None:
    table = run.run.metrics
    pairs = zip(table.texts["tags"], table.numbers[metric], strict=True)
    values = [value for tags, value in pairs if tag in tags.split()]
    return float(np.mean(values)) if values and not np.isnan(values).any() else None


def _seed_row(study: Study, run: ReportRun, metrics: Sequence[str]) -> dict[str, str | Link]:
    record = run.record
    row: dict[str, str | Link] = {"Scene": run.scene} if len(study.scenes) > 1 else {}
    row |= {"Method": run.method, "Seed": str(run.seed)}
    for metric in metrics:
        row[heading_of(metric, study)] = mean_text([run.mean(metric)], digits(metric))
    row["Train (s)"] = mean_text([record.train_s], 1)
    if len(record.timings) > 1:  # archives of before have the training alone
        row["All stages (s)"] = f"{sum(stage.wall_s for stage in record.timings.values()):.1f}"
        row["Peak memory (MiB)"] = f"{record.peak_memory_bytes / 2**20:.0f}"
    row["Gaussians"] = str(record.gaussians)
    row["PLY (kB)"] = f"{record.ply_bytes / 1000:.0f}" if record.ply_bytes else ABSENT
    row["Parameters"] = f"`{record.parameters_sha256[:12]}`"
    name = outside(run.run.run_dir.name)
    row["Folder"] = Link(name, folder_target(study, run)) if study.linked else name
    for heading, link in (("View", view_link(study, run)), ("Video", video_link(study, run))):
        row |= {} if link is None else {heading: link}
    return row


def _without(rows: Rows, heading: str) -> Rows:
    return [{k: v for k, v in row.items() if k != heading} for row in rows]
