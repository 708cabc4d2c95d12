"""The tables of a report, as frames of text ready to print. A value that is missing shows as `–`
and its reason is listed in the report."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

import numpy as np
import pandas as pd

from framework.report.collect import ReportRun, Study
from framework.report.finding import interval_text, p_text
from framework.report.outcomes import Outcomes, seed_means
from framework.report.statistics import spread

ABSENT = "–"
ALL_SCENES = "mean of all"
DIGITS = {"psnr": 2, "ssim": 4, "flip": 4, "lpips": 4}
HEADINGS = {"psnr": "PSNR (dB)", "ssim": "SSIM ↑", "flip": "FLIP ↓", "lpips": "LPIPS ↓"}


def main_table(study: Study) -> pd.DataFrame:
    """One row per scene and method, and over all scenes where there are several."""
    rows = []
    groups = [(scene, [scene]) for scene in study.scenes]
    if len(study.scenes) > 1:
        groups.append((ALL_SCENES, study.scenes))
    for label, scenes in groups:
        for method in study.methods:
            runs = [run for run in study.of(method=method) if run.scene in scenes]
            if runs:
                rows.append({"Scene": label} | _main_row(study, method, runs, scenes))
    frame = pd.DataFrame(rows)
    return frame if len(groups) > 1 else frame.drop(columns="Scene")


def comparison_table(found: Outcomes) -> pd.DataFrame:
    """Every method against the baseline."""
    return pd.DataFrame(
        [
            {
                "Method": c.method,
                "Compared with": c.baseline,
                "Pairs": str(c.n),
                "ΔPSNR (dB)": f"{c.difference:+.2f}",
                "95 % interval": interval_text(c.interval) if c.interval else ABSENT,
                "p": p_text(c.p) if c.p is not None else ABSENT,
                "p after Holm": p_text(c.p_holm) if c.p_holm is not None else ABSENT,
            }
            for c in found.comparisons.values()
        ]
    )


def tags_of(study: Study, scene: str) -> list[str]:
    """The tags that mark some test views of a scene, `interpolating` before `extrapolating`."""
    texts = {text for run in study.of(scene) for text in run.run.metrics["tags"]}
    tags = {tag for text in texts for tag in text.split()}
    return sorted(tags, key=lambda tag: (tag != "interpolating", tag))


def tag_table(study: Study, scene: str, tags: Sequence[str]) -> pd.DataFrame:
    """PSNR and SSIM of the test views with each tag: mean over the views, then over the seeds."""
    rows = []
    for method in study.methods:
        runs = study.of(scene, method)
        if not runs:
            continue
        row = {"Method": method}
        for tag in tags:
            for metric in ("psnr", "ssim"):
                values = [_tag_mean(run, tag, metric) for run in runs]
                heading = f"{HEADINGS[metric]}, {tag} ({_tag_count(runs[0], tag)} views)"
                row[heading] = _mean_text(values, DIGITS[metric])
        rows.append(row)
    return pd.DataFrame(rows)


def seed_table(study: Study) -> pd.DataFrame:
    """One row per run."""
    frame = pd.DataFrame([_seed_row(study, run) for run in study.runs])
    return frame if len(study.scenes) > 1 else frame.drop(columns="Scene")


def measured(study: Study) -> list[str]:
    """The metrics of the main table: LPIPS only where some run has it."""
    has_lpips = any(run.mean("lpips") is not None for run in study.runs)
    return ["psnr", "ssim", "flip", *(["lpips"] if has_lpips else [])]


def _main_row(
    study: Study, method: str, runs: list[ReportRun], scenes: list[str]
) -> dict[str, str]:
    row = {"Method": method}
    for metric in measured(study):
        values = list(seed_means(runs, scenes, metric).values())
        row[HEADINGS[metric]] = _mean_text(values, DIGITS[metric])
        if metric == "psnr":
            row["σ_PSNR (dB)"] = _sigma_text(values)
    row["Train (s)"] = _mean_text([run.record.train_s for run in runs], 1)
    row["Gaussians"] = _mean_text([float(run.record.gaussians) for run in runs], 0)
    return row


def _sigma_text(values: Sequence[float]) -> str:
    if not values:
        return ABSENT
    found = spread(values)
    if found.sd is None or found.sd_interval is None:
        return f"{ABSENT} (n = 1)"
    return f"{found.sd:.3f} [{interval_text(found.sd_interval, 3)}] (n = {found.n})"


def _mean_text(values: Sequence[float | None], digits: int) -> str:
    """The mean, `–` unless there are values and none is missing."""
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return ABSENT
    return f"{float(np.mean(known)):.{digits}f}"


def _tag_mean(run: ReportRun, tag: str, metric: str) -> float | None:
    values = run.run.metrics.loc[_tagged(run, tag), metric]
    return None if values.empty or values.isna().any() else float(values.mean())


def _tag_count(run: ReportRun, tag: str) -> int:
    return int(_tagged(run, tag).sum())


def _tagged(run: ReportRun, tag: str) -> pd.Series:
    return run.run.metrics["tags"].map(lambda text: tag in text.split())


def _seed_row(study: Study, run: ReportRun) -> dict[str, str]:
    record = run.record
    row = {"Scene": run.scene, "Method": run.method, "Seed": str(run.seed)}
    for metric in measured(study):
        row[HEADINGS[metric]] = _mean_text([run.mean(metric)], DIGITS[metric])
    row["Train (s)"] = _mean_text([record.train_s], 1)
    row["All stages (s)"] = f"{sum(stage.wall_s for stage in record.timings.values()):.1f}"
    row["Peak memory (MiB)"] = f"{record.peak_memory_bytes / 2**20:.0f}"
    row["Gaussians"] = str(record.gaussians)
    row["PLY (kB)"] = f"{record.ply_bytes / 1000:.0f}"
    row["Parameters"] = f"`{record.parameters_sha256[:12]}`"
    folder = run.run.run_dir.relative_to(study.study_dir).as_posix()
    row["Folder"] = f"[{run.run.run_dir.name}]({quote(folder)}/)"
    return row
