"""Tables of a report, as rows of cells by heading.

A missing value is `–`; "Missing metrics" lists the reason. A mean carries ± half the width of its
95 % interval. Cells of a method hold the method, for the page's filter.
"""

import math
import os
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from urllib.parse import quote

import numpy as np

from framework.files.opened import is_file
from framework.metrics.values import (
    AVERAGE,
    COADAPTATION,
    LOWER,
    METRICS,
    NOT_REQUESTED,
    RANK,
    Missing,
    digits,
)
from framework.records.run_files import VIDEOS, VIEW
from framework.records.search import Searched
from framework.report.costs import entries, paying, train_s
from framework.report.findings import ACTED, Contest
from framework.report.statistics.compare import Comparison
from framework.report.statistics.numbers import (
    ABSENT,
    format_difference,
    format_interval,
    format_mean,
    format_p,
    format_sigma,
    format_significant,
    format_span,
)
from framework.report.statistics.outcomes import seed_means
from framework.report.statistics.robustness import failures, wilson
from framework.report.statistics.variance import SigmaComparison
from framework.report.stress import Panel
from framework.report.study.methods import Method
from framework.report.study.scenes import marked
from framework.report.study.study import DAMAGED, FailedRun, ReportRun, Study
from framework.report.study.words import code, outside

ALL_SCENES = "mean of all"
LPIPS = ("lpips", "lpips_01")
NAMES = {
    **{"psnr": "PSNR", "ssim": "SSIM", "flip": "FLIP", "lpips": "LPIPS"},
    "lpips_01": "LPIPS on [0, 1], as papers do",
    **{AVERAGE: "AVGE", COADAPTATION: "Co-adaptation", RANK: "Effective rank"},
}
UNITS = {"psnr": "(dB)", "ssim": "↑", RANK: "(1 needles, 3 balls)"}
PLACES = {"psnr": 2, "ssim": 3, "lpips": 3}  # of the table of results
DOSES = {
    "views_asked": "Epochs that requested pseudo views",
    "views_made": "Pseudo views made",
    "refused_coverage": "Rejected for low coverage",
    "coverage_mean": "Mean coverage",
    "pseudo_share_of_loss": "Share of the loss from pseudo views",
    "share_dropped_mean": "Mean share dropped",
    "ranked_mean": "Mean number of Gaussians ranked",
    "supports_mean": "Mean number of supports",
    ACTED: "Share of its opportunities with an effect (smallest part)",
    f"augment_{ACTED}": "With an effect: augmenter",
    f"reg_{ACTED}": "With an effect: regularizer",
    "refused_other": "Rejected for other reasons",
    "coverage_of_depth_mean": "Mean coverage of the area with depth",
    "support_distance_mean": "Mean distance of supports (camera spacings)",
    "nearest_mean": "Share of pseudo views that use the nearest photo",
    "support_rank_mean": "Mean rank of supports by distance (1: the nearest photo)",
    "pseudo_share_of_views": "Share of pseudo views among the renders",
}


@dataclass(frozen=True)
class Link:
    """A cell that links to a file of the study."""

    text: str
    target: str


@dataclass(frozen=True)
class Result:
    """A value of the table of results: mean ± sigma over seeds, with fixed decimals.

    Attributes:
        rank: 1 for the best of its column, 2 for the second; else 0, as for one seed if others
            have more.
        fewer: its number of seeds, if other results of the table have more, else 0.
    """

    mean: float
    sigma: float | None
    places: int
    rank: int = 0
    fewer: int = 0

    @property
    def text(self) -> str:
        return f"{self.mean:.{self.places}f}"

    @property
    def sigma_text(self) -> str:
        return "" if self.sigma is None else f"{self.sigma:.{self.places}f}"

    @property
    def seeds_text(self) -> str:
        return f" (n = {self.fewer})" if self.fewer else ""

    def __str__(self) -> str:
        spread = f" ± {self.sigma_text}" if self.sigma_text else ""
        return f"{self.text}{spread}{self.seeds_text}"


Cell = str | Link | Method | Result
Row = dict[str, Cell]


def heading_of(metric: str, study: Study | None = None) -> str:
    """The heading of a metric's column; LPIPS with the network of the runs, if they name it."""
    if metric not in NAMES:  # a metric of a plugin
        return outside(metric)
    name = NAMES[metric]
    if study is not None and metric in LPIPS and study.lpips_networks:
        name = name.replace("LPIPS", f"LPIPS ({', '.join(study.lpips_networks)})")
    return f"{name} {UNITS.get(metric, '↓')}"


def measured(study: Study) -> list[str]:
    """Metrics of the main table: LPIPS if some run has it, none if nothing was tested."""
    if study.runs and not study.tested:
        return []
    lpips = [m for m in LPIPS if any(run.mean(m) is not None for run in study.runs)]
    return ["psnr", "ssim", "flip", *lpips, *study.other_metrics]


def without(rows: Sequence[Row], *headings: str) -> list[Row]:
    """The rows without some columns."""
    return [{k: v for k, v in row.items() if k not in headings} for row in rows]


def results(study: Study) -> dict[Method, dict[str, Result | None]]:
    """Method -> metric -> result, of the mean over the tested scenes for seeds with all of them."""
    metrics = [metric for metric in PLACES if metric in measured(study)]
    seeds = {
        metric: {
            method: list(seed_means(study.of(method=method), study.tested, metric).values())
            for method in study.methods
        }
        for metric in metrics
    }
    most = max((len(v) for column in seeds.values() for v in column.values()), default=0)
    columns = {metric: _results(seeds[metric], metric, most) for metric in metrics}
    return {
        method: {metric: columns[metric].get(method) for metric in metrics}
        for method in study.methods
    }


def results_rows(results: Mapping[Method, Mapping[str, Result | None]]) -> list[Row]:
    """A row per method."""
    return [
        {"Method": method, **{heading_of(metric): r or ABSENT for metric, r in columns.items()}}
        for method, columns in results.items()
    ]


def _results(
    seeds: Mapping[Method, Sequence[float]], metric: str, most: int
) -> dict[Method, Result]:
    column: dict[Method, Result] = {}
    for method, values in seeds.items():
        if values:
            sigma = float(np.std(values, ddof=1)) if len(values) > 1 else None
            fewer = len(values) if len(values) < most else 0
            column[method] = Result(float(np.mean(values)), sigma, PLACES[metric], fewer=fewer)
    order = sorted({float(r.text) for r in column.values()}, reverse=metric not in LOWER)
    ranks = {value: k + 1 for k, value in enumerate(order[:2])} if len(column) > 1 else {}
    ranked = {
        method: replace(result, rank=ranks.get(float(result.text), 0))
        for method, result in column.items()
        if result.sigma is not None or not result.fewer
    }
    return column | ranked


def main_rows(study: Study, scenes: Sequence[str]) -> list[Row]:
    """One row per scene and method, and over all `scenes` if there are several."""
    groups = [(scene, [scene]) for scene in scenes]
    tested = [scene for scene in scenes if scene in study.tested]
    if len(tested) > 1:
        groups.append((ALL_SCENES, tested))
    rows: list[Row] = []
    for label, members in groups:
        shown_as = label if label == ALL_SCENES else marked(label, study.name_of(label))
        for method in study.methods:
            runs = [run for run in study.of(method=method) if run.scene in members]
            if runs:
                rows.append({"Scene": shown_as} | _main_row(study, method, runs, members))
    return rows if len(groups) > 1 else without(rows, "Scene")


def _main_row(study: Study, method: Method, runs: list[ReportRun], scenes: list[str]) -> Row:
    row: Row = {"Method": method}
    n_seeds = len(seed_means(runs, scenes))
    for metric in measured(study):
        values = list(seed_means(runs, scenes, metric).values())
        text = format_mean(values, digits(metric), show_half=metric == "psnr")
        fewer = 0 < len(values) < n_seeds
        row[heading_of(metric, study)] = f"{text} (n = {len(values)})" if fewer else text
        if metric == "psnr":
            row["σ_PSNR (dB)"] = format_sigma(values)
    row["Train (s)"] = format_mean([run.record.train_s for run in runs], 1)
    row["CPU (s)"] = format_mean([run.record.train_cpu_s for run in runs], 1)
    row["Gaussians"] = format_mean([float(run.record.gaussians) for run in runs], 0)
    row["Parameters (k)"] = format_mean([run.record.parameters / 1000 for run in runs], 0)
    return row


def comparison_rows(comparisons: Iterable[Comparison]) -> list[Row]:
    """Every method compared with its baseline."""
    return [
        {"Method": c.method, "Compared with": c.baseline, **_tested_cells(c)} for c in comparisons
    ]


def _tested_cells(c: Comparison) -> Row:
    """The numbers of a paired comparison, corrected for all comparisons of its table."""
    cells: Row = {
        "Seeds": str(c.n),
        "ΔPSNR (dB)": format_difference(c.difference),
        "these scenes, 95 %": format_interval(c.joint) if c.joint else ABSENT,
        "p": format_p(c.p_joint) if c.p_joint is not None else ABSENT,
    }
    if c.like is not None:
        cells["Scenes"] = str(c.like.n)
        cells["scenes like these, 95 %"] = format_interval(c.like_joint) if c.like_joint else ABSENT
    return cells


def contest_rows(contests: Sequence[Contest]) -> list[Row]:
    """Every capacity compared with the first one of its method."""
    return [
        {
            "Method": c.method,
            "Capacity": capacity_text(c.comparison.method),
            "Compared with": capacity_text(c.comparison.baseline),
            **_tested_cells(c.comparison),
            "Parameters, times": ABSENT
            if c.parameters is None
            else format_significant(c.parameters),
            "CPU, times": ABSENT if c.cpu is None else format_significant(c.cpu),
        }
        for c in contests
    ]


def capacity_text(method: Method) -> str:
    """`evidence (criterion=laplace)`, or `fixed`, which has no name among methods."""
    if not method.capacity:
        return "fixed"
    (_, name), *options = method.capacity
    rest = ", ".join(f"{key}={value}" for key, value in options)
    return f"{name} ({rest})" if rest else name


def sigma_rows(sigmas: Iterable[SigmaComparison]) -> list[Row]:
    """The standard deviation of every method compared with its baseline's."""
    return [
        {
            "Method": c.method,
            "Compared with": c.baseline,
            "σ / σ": format_significant(c.ratio) if c.ratio is not None else ABSENT,
            "95 % interval": format_span(c.interval) if c.interval else ABSENT,
            "r": ABSENT if c.rho is None else f"{c.rho:.2f}",
            "p": format_p(c.p_joint),
            "Seeds": str(c.n) if c.n == c.other_n else f"{c.n} and {c.other_n}",
        }
        for c in sigmas
    ]


def cost_rows(study: Study, scene: str) -> list[Row]:
    """What every method costs on a scene."""
    result = entries(study, scene)
    pay = [result[k].method for k in paying(result, train_s)]
    marks = {method: "cheapest" if method == pay[0] else "yes" for method in pay}
    return [
        {
            "Method": method,
            "PSNR (dB)": format_mean([run.mean("psnr") for run in runs], 2, show_half=True),
            "Train, wall (s)": format_mean([run.record.train_s for run in runs], 1),
            "Train, CPU (s)": format_mean([run.record.train_cpu_s for run in runs], 1),
            "Render (frames/s)": format_mean([_frames_per_s(run) for run in runs], 1),
            "Gaussians": format_mean([float(run.record.gaussians) for run in runs], 0),
            "Parameters (k)": format_mean([run.record.parameters / 1000 for run in runs], 0),
            "PLY (kB)": format_mean([run.record.ply_bytes / 1000 or None for run in runs], 0),
            "More time pays": marks.get(method, "not shown"),
        }
        for method in study.methods
        if (runs := study.of(scene, method))
    ]


def _frames_per_s(run: ReportRun) -> float | None:
    """Test views per second of rendering; None if no time was taken."""
    seconds = run.run.metrics.numbers["render_s"]
    return len(seconds) / float(seconds.sum()) if seconds.sum() > 0 else None


def worst_rows(study: Study) -> list[Row]:
    """The worst case of every method on every scene, and its failures."""
    rows: list[Row] = []
    scenes = study.tested if study.runs else sorted({run.scene for run in study.failed})
    for scene in scenes:
        for method in study.tried:
            failed, n = failures(study, method, scene)
            if n > 0:
                share = wilson(failed, n)
                text = f"{failed} of {n} [{100 * share.low:.0f} to {100 * share.high:.0f} %]"
                cells = _worst_cells(study.of(scene, method))
                rows.append({"Scene": scene, "Method": method, **cells, "Failed runs": text})
    return rows if len(scenes) > 1 else without(rows, "Scene")


def _worst_cells(runs: list[ReportRun]) -> Row:
    """The worst mean of a run and the worst views; `–` if no view has a finite PSNR."""
    cells = (ABSENT,) * 3
    views = [(psnr, run.seed, view) for run in runs for view, psnr in run.psnr.items()]
    finite = [view for view in views if not math.isnan(view[0])]
    means = [(psnr, run.seed) for run in runs if (psnr := run.mean("psnr")) is not None]
    if finite and means:
        (mean, seed), (lowest, of_view, view) = min(means), min(finite)
        percentile = np.percentile([psnr for psnr, _, _ in finite], 5)
        worst_view = f"{lowest:.2f} ({outside(view)}, seed {of_view})"
        cells = f"{mean:.2f} (seed {seed})", worst_view, f"{percentile:.2f}"
    headings = ("Worst seed (dB)", "Worst view (dB)", "5th percentile of views (dB)")
    return dict(zip(headings, cells, strict=True))


def dose_rows(study: Study) -> list[Row]:
    """Return the dose of each method from the trainer's counts; no rows without counts."""
    rows: list[Row] = [
        {"Scene": scene, "Method": method, **_dose_cells(runs)}
        for scene in study.scenes
        for method in study.methods
        if (runs := [run for run in study.of(scene, method) if run.record.dose])
    ]
    return rows if len(study.scenes) > 1 else without(rows, "Scene")


def _dose_cells(runs: Sequence[ReportRun]) -> Row:
    present = {key for run in runs for key in run.record.dose}
    parts = {f"{group}_{ACTED}" for group in ("augment", "reg")}
    if len(present & parts) == 1:  # equal to the share of all occasions
        present -= parts
    keys = [key for key in DOSES if key in present] + sorted(present - set(DOSES))
    return {DOSES.get(key, _dose_heading(key)): _dose_cell(runs, key) for key in keys}


def _dose_heading(key: str) -> str:
    """`supports_mean` as `Mean supports`."""
    words = outside(key).replace("_", " ").strip()
    mean = f"Mean {words.removesuffix(' mean')}" if words.endswith(" mean") else words
    return mean[:1].upper() + mean[1:]


def _dose_cell(runs: Sequence[ReportRun], key: str) -> str:
    """The mean of numbers; else the distinct texts."""
    values = [run.record.dose[key] for run in runs if key in run.record.dose]
    if values and all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        mean = float(np.mean([float(value) for value in values]))
        return f"{mean:,.0f}" if mean.is_integer() or abs(mean) >= 100 else f"{mean:.3g}"
    texts = dict.fromkeys(outside(str(value)) for value in values if value is not None)
    return ", ".join(texts) or ABSENT


def seed_rows(study: Study) -> list[Row]:
    """One row per run."""
    metrics = measured(study)
    rows = [_seed_row(study, run, metrics) for run in study.runs]
    return rows if len(study.scenes) > 1 else without(rows, "Scene")


def _seed_row(study: Study, run: ReportRun, metrics: Sequence[str]) -> Row:
    record = run.record
    row: Row = {"Scene": run.scene, "Method": run.method, "Seed": str(run.seed)}
    for metric in metrics:
        row[heading_of(metric, study)] = format_mean([run.mean(metric)], digits(metric))
    row["Train (s)"] = format_mean([record.train_s], 1)
    if len(record.timings) > 1:  # older archives have the training alone
        row["All stages (s)"] = f"{sum(stage.wall_s for stage in record.timings.values()):.1f}"
        row["Peak memory (MiB)"] = f"{record.peak_memory_bytes / 2**20:.0f}"
    row["Gaussians"] = str(record.gaussians)
    row["PLY (kB)"] = f"{record.ply_bytes / 1000:.0f}" if record.ply_bytes else ABSENT
    row["Parameters"] = f"`{record.parameters_sha256[:12]}`"
    name = outside(run.run.run_dir.name)
    row["Folder"] = Link(name, folder_target(study, run)) if study.linked else name
    links = {"View": run_link(study, run, "in 3D", (VIEW,))}
    links["Video"] = run_link(study, run, "video", VIDEOS)
    return row | {heading: link for heading, link in links.items() if link is not None}


def folder_target(study: Study, run: ReportRun) -> str:
    """The run's folder as a link from the report."""
    return quote(os.fsencode(study.folder_of(run.run.run_dir))) + "/"


def run_link(study: Study, run: ReportRun, text: str, names: Sequence[str]) -> Link | None:
    """Link to the first of these files in the run's folder; None if the report has no links."""
    there = [name for name in names if is_file(run.run.run_dir / name)] if study.linked else []
    return Link(text, folder_target(study, run) + there[0]) if there else None


def stress_rows(panel: Panel) -> list[Row]:
    """A row per method, a column per strength: mean PSNR in dB."""
    rows: list[Row] = []
    for method, by_level in panel.runs.items():
        rows.append({"Method": method})
        for level in panel.levels:
            values = [run.mean("psnr") for run in by_level.get(level, [])]
            rows[-1][f"{panel.axis.short} = {level:g}"] = format_mean(values, 2, show_half=True)
    return rows


def failure_rows(study: Study) -> list[Row]:
    """Every failed run with its kind and reason, and the command that repeats it."""
    return [
        {
            "Run": code(study.folder_of(run.run.run_dir)),
            "Kind": outside(run.kind),
            "Reason": outside(run.record.error or "unknown error"),
            "Again": "" if run.kind == DAMAGED else _again(run),
        }
        for run in study.failed
    ]


def _again(run: FailedRun) -> str:
    return code(run.again or shlex.join(["python", "run.py", *run.record.overrides, "-m"]))


def missing_metrics(study: Study) -> list[tuple[str, int, str]]:
    """(metric, number of runs without it, reason), sorted."""
    counts = Counter(
        (NAMES.get(metric, outside(metric)), outside(value.reason))
        for run in study.runs
        for metric in (*METRICS, *study.other_metrics)
        if isinstance(value := run.record.summary.get(metric), Missing) and value != NOT_REQUESTED
    )
    return [(metric, n, reason) for (metric, reason), n in sorted(counts.items())]


def trial_rows(searched: Searched) -> list[Row]:
    """All trials of a search, the best first, then those that failed."""
    sign = 1 if searched.metric in LOWER else -1
    order = sorted(
        searched.trials, key=lambda t: (t.value is None, sign * (t.value or 0.0), t.number)
    )
    places = digits(searched.metric)
    rows: list[Row] = [
        {
            "Trial": str(trial.number),
            NAMES[searched.metric]: "" if trial.value is None else f"{trial.value:.{places}f}",
            "Options": code(" ".join(trial.words)),
            "Train CPU s": f"{trial.train_s:.1f}",
            "Run": code(trial.run) if trial.run else "",
            "Reason": outside(trial.error),
        }
        for trial in order
    ]
    return rows if any(row["Reason"] for row in rows) else without(rows, "Reason")
