"""`fishersplat compare RUN RUN`: a small report of two runs.

Which options differ, what every test view gained, where the pictures differ, and the quality over
training time. Two single runs cannot distinguish a method from chance; a study with seeds does.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from framework.errors import Arguments, require
from framework.files.whole import make_folder
from framework.metrics.values import AVERAGE, digits
from framework.records.provenance import NEUTRAL_KEYS
from framework.records.record import RECORD, Run, read_run
from framework.report.figures.charts import curves
from framework.report.figures.pictures import draw_closeup
from framework.report.gallery import gallery
from framework.report.main import tell
from framework.report.provenance import code_of
from framework.report.render import Page, publish, say
from framework.report.statistics.numbers import ABSENT, format_difference
from framework.report.study.methods import Method, methods_of
from framework.report.study.scenes import scene_labels
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import flatten, outside, value_text
from framework.report.tables import Row, heading_of

REPORT = "compare.md"
NO_OPTIONS = ("metrics", *NEUTRAL_KEYS)
METRICS = ("psnr", "ssim", "flip", "lpips", AVERAGE)


@dataclass(frozen=True)
class PairVerdict:
    """Which run has the higher PSNR, and on how many of the common views."""

    high: ReportRun
    low: ReportRun
    same_scene: bool
    better: int
    views: int


def compare_runs(first: Path, second: Path, out_dir: Path) -> tuple[Path, str]:
    """Write the report of two complete runs; returns its path and its verdict.

    Raises:
        UserError: other folders, or pictures that do not belong to a run.
    """
    require(first.resolve() != second.resolve(), f"{first}: expected two runs, got one twice")
    runs = one, other = _labelled([_complete(first), _complete(second)])
    make_folder(out_dir)
    study = Study(out_dir, runs, rival=runs[0].method)
    scenes = sorted({run.scene for run in runs})
    same = scenes if len(scenes) == 1 else []
    context = {
        "pair": _verdict(one, other, bool(same)),
        "options": _options(one, other),
        "closeups": [picture for scene in same if (picture := draw_closeup(study, scene))],
        "views": _views(one, other) if same else [],
        "curves": [picture for scene in same if (picture := curves(study, scene))],
        "facts": _facts(study),
    }
    title = f"{other.method} compared with {one.method}"
    data = {**gallery(study, same), "beside": True}
    page = Page(title, out_dir, study.families, (), data)
    publish("compare.jinja", out_dir / REPORT, page, context)
    return out_dir / REPORT, say("pair_verdict", **context)


def _complete(folder: Path) -> Run:
    require(
        os.path.lexists(folder / RECORD),
        f"{folder}: expected the folder of a run, got none with {RECORD}; give two as"
        " reports/embedded/runs/NAME",
    )
    run = read_run(folder)
    require(
        run.record.status == "complete",
        f"{folder}: expected a complete run, got one that failed; run it again",
    )
    return run


def _labelled(runs: Sequence[Run]) -> tuple[ReportRun, ...]:
    """With methods that differ: by their options, else with the seed, else by folder."""
    configs = [run.record.config for run in runs]
    scenes = scene_labels(configs, [run.record.scene for run in runs])
    methods = methods_of(configs)
    seeds = [str(run.record.seed) for run in runs]
    folders = [outside(f"{run.run_dir.parent.parent.name}/{run.run_dir.name}") for run in runs]
    for key, values in (("seed", seeds), ("run", folders), ("run", ["first", "second"])):
        if len(set(methods)) < 2:
            methods = [
                replace(method, options=((key, value),))
                for method, value in zip(methods, values, strict=True)
            ]
    alike = len({run.record.scene.fingerprint for run in runs if run.record.scene}) == 1
    labels = [replace(s, name=scenes[0].name, options=(), mark="") if alike else s for s in scenes]
    parts = zip(runs, map(_flat, methods), labels, strict=True)
    return tuple(ReportRun(*part) for part in parts)


def _flat(method: Method) -> Method:
    """Add the budget to the options, so that every run is a separate family."""
    return replace(method, options=(*method.options, *method.budget), limits=(), capacity=())


def _verdict(a: ReportRun, b: ReportRun, same_scene: bool) -> PairVerdict:
    low, high = sorted((a, b), key=lambda run: run.mean("psnr") or 0.0)
    views = [view for view in a.psnr if view in b.psnr]
    better = sum(high.psnr[view] > low.psnr[view] for view in views)
    return PairVerdict(high, low, same_scene, better, len(views))


def _options(a: ReportRun, b: ReportRun) -> list[Row]:
    """The options that differ, by their full names."""
    one, other = (flatten(run.record.config) for run in (a, b))
    rows: list[Row] = []
    for key in sorted(one.keys() | other.keys()):
        values = [value_text(item[key]) if key in item else "" for item in (one, other)]
        if key not in NO_OPTIONS and values[0] != values[1]:
            rows.append({"Option": outside(key), **_cells(a, b, values)})
    return rows


def _cells(a: ReportRun, b: ReportRun, values: Sequence[str]) -> dict[str, str]:
    return {str(a.method): values[0], str(b.method): values[1]}


def _views(a: ReportRun, b: ReportRun) -> list[Row]:
    """PSNR of both on every common view with its difference, and the other metrics."""
    metrics = [m for m in METRICS if any(run.mean(m) is not None for run in (a, b))]
    columns = [{m: _column(run, m) for m in metrics} for run in (a, b)]
    rows: list[Row] = []
    for view in [view for view in a.psnr if view in b.psnr]:
        row: Row = {"View": outside(view)}
        for metric in metrics:
            one, other = (values[metric].get(view, math.nan) for values in columns)
            for run, value in ((a, one), (b, other)):
                row[f"{heading_of(metric)}, {run.method}"] = _text(value, digits(metric))
            if metric == "psnr":
                difference = other - one
                finite = math.isfinite(difference)
                row["difference (dB)"] = format_difference(difference) if finite else ABSENT
        rows.append(row)
    return rows


def _column(run: ReportRun, metric: str) -> Mapping[str, float]:
    result = run.run.metrics
    if metric not in result.numbers:
        return {}
    return dict(zip(result.texts["view"], result.numbers[metric].tolist(), strict=True))


def _text(value: float, places: int) -> str:
    return f"{value:.{places}f}" if math.isfinite(value) else ABSENT


def _facts(study: Study) -> list[Row]:
    records = [run.record for run in study.runs]
    facts = {
        "Training, wall (s)": [_text(r.train_s or math.nan, 1) for r in records],
        "Training, CPU (s)": [_text(r.train_cpu_s or math.nan, 1) for r in records],
        "Gaussians": [f"{r.gaussians:,}" for r in records],
        "Parameters": [f"{r.parameters:,}" for r in records],
        "PLY (kB)": [f"{r.ply_bytes / 1000:,.0f}" for r in records],
        "Hash of the parameters": [r.parameters_sha256[:12] for r in records],
        "Code": [code_of(r.provenance) for r in records],
        "Run": [outside(study.folder_of(r.run.run_dir)) for r in study.runs],
    }
    a, b = study.runs
    return [{"What": name, **_cells(a, b, values)} for name, values in facts.items()]


def main(arguments: list[str], prog: str) -> int:
    """The subcommand; exit status 0.

    Raises:
        UserError: for bad input.
    """
    text = "A small report of two runs: options that differ, every view, pictures, courses."
    parser = Arguments(prog=prog, description=text)
    parser.add_argument(
        "runs", type=Path, nargs=2, metavar="RUN", help="folder of a run, as reports/demo/runs/NAME"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("compare"), help="folder of the report (default: compare)"
    )
    options = parser.parse_args(arguments)
    first, second = options.runs
    tell("compared", *compare_runs(first, second, options.out))
    return 0
