"""`fishersplat compare RUN RUN`: a small report of two runs, beside each other.

Which options differ, what every test view gained, where the pictures differ, how they got there.
Two single runs say nothing of chance, which the first line tells; a study with seeds does.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from framework.errors import Arguments, printable_line, require
from framework.files.whole import make_folder, write_whole
from framework.metrics.values import AVERAGE, digits
from framework.records.provenance import NEUTRAL_KEYS
from framework.records.record import METHOD_GROUPS, RECORD, Run, read_run
from framework.report.figures.closeup import draw_closeup
from framework.report.figures.curves import evaluations
from framework.report.figures.files import chart_picture
from framework.report.figures.images import draw_images
from framework.report.page import html as page
from framework.report.page import markdown
from framework.report.page.gallery import gallery
from framework.report.parts.chart import MIN_SPAN_DB, Chart, Point, Series
from framework.report.parts.document import Block, Document, Heading, Link, Picture, Text, table
from framework.report.parts.palette import looks
from framework.report.statistics.numbers import ABSENT, signed
from framework.report.study.labels import (
    MethodLabel,
    SceneLabel,
    flatten,
    method_labels,
    outside,
    scene_labels,
    text_of,
)
from framework.report.study.names import heading_of
from framework.report.study.runs import ReportRun, Study
from framework.report.text.provenance import code_of

REPORT, PAGE = "compare.md", "compare.html"
UNTOLD = ("metrics", *NEUTRAL_KEYS)
WORDS = ("Option", "View", "What")
SINGLE = "Single runs say nothing of chance: a study with several seeds does."
SAME_OPTIONS = "No option differs: the runs differ in their code, their machine or nothing."
CURVES = "Test PSNR at the evaluation steps against training seconds."


def compare_runs(first: Path, second: Path, out_dir: Path) -> Path:
    """Write the report of two complete runs; returns its path. Raises UserError for other folders
    and for pictures that do not belong to a run."""
    require(first.resolve() != second.resolve(), f"{first}: expected two runs, got one twice")
    runs = _labelled([_complete(first), _complete(second)])
    make_folder(out_dir)
    study = Study(out_dir, runs, (), ())
    blocks, families = tuple(_blocks(study)), tuple(study.families)
    made = Document(_title(runs), blocks, (), families, beside=True)
    write_whole(out_dir / PAGE, page.render(made, gallery(study, _same_scene(study)), out_dir))
    write_whole(out_dir / REPORT, markdown.render(made))
    return out_dir / REPORT


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
    """With names that differ: by method, else with the seed, else by folder."""
    configs = [run.record.config for run in runs]
    scenes = scene_labels(configs, [run.record.scene for run in runs])
    names = [label.full for label in method_labels(configs)]
    if len(set(names)) < 2:
        names = [f"{n}, seed={r.record.seed}" for n, r in zip(names, runs, strict=True)]
    if len(set(names)) < 2:
        names = [outside(f"{run.run_dir.parent.parent.name}/{run.run_dir.name}") for run in runs]
    if len(set(names)) < 2:
        names = ["first", "second"]
    alike = len({run.record.scene.fingerprint for run in runs if run.record.scene}) == 1
    labels = [SceneLabel(scenes[0].name, s.name, s.data) if alike else s for s in scenes]
    parts = zip(runs, map(MethodLabel, names), labels, strict=True)
    return tuple(ReportRun(*part) for part in parts)


def _title(runs: Sequence[ReportRun]) -> str:
    return " against ".join(run.method for run in runs)


def _same_scene(study: Study) -> list[str]:
    """The scene that both runs trained on, as a list; empty where these differ."""
    scenes = {run.scene for run in study.runs}
    return sorted(scenes) if len(scenes) == 1 else []


def _blocks(study: Study) -> list[Block]:
    a, b = study.runs
    same = _same_scene(study)
    blocks: list[Block] = [Heading(1, _title(study.runs)), Text(_verdict(a, b, same), "verdict")]
    options, inner = _options(a, b)
    blocks += [table(options, WORDS)] if options else [Text(SAME_OPTIONS, "note")]
    pairs = (a.method, b.method)
    pictures = [draw_closeup(study, scene, pairs) for scene in same]
    pictures += [draw_images(study, scene) for scene in same]
    shown = [picture for picture in pictures if picture is not None]
    blocks += [Heading(2, "Pictures"), *shown] if shown else []
    rows = _views(a, b) if same else []
    blocks += [Heading(2, "Every test view"), table(rows, WORDS)] if rows else []
    curve = _curves(study)
    blocks += [Heading(2, "Quality over training time"), curve] if curve else []
    blocks += [Heading(2, "Options of plugins that only one run has")] if inner else []
    blocks += [table(inner, WORDS)] if inner else []
    return [*blocks, Heading(2, "Cost, size and code"), table(_facts(study), WORDS)]


def _verdict(a: ReportRun, b: ReportRun, same: Sequence[str]) -> str:
    if not same:
        return f"Different scenes, hence not compared: {a.scene} and {b.scene}."
    one, other = a.mean("psnr"), b.mean("psnr")
    if one is None or other is None:
        return "Not compared: a run without test views, or without a finite PSNR."
    if one == other:
        return f"Both reach {one:.2f} dB on {a.scene}. {SINGLE}"
    high, low = (a, b) if one > other else (b, a)
    views = _common(a, b)
    better = sum(high.psnr[view] > low.psnr[view] for view in views)
    return (
        f"{high.method} reaches {max(one, other):.2f} dB on {a.scene}, {abs(one - other):.2f} dB"
        f" above {low.method}, and is higher on {better} of {len(views)} test views. {SINGLE}"
    )


def _common(a: ReportRun, b: ReportRun) -> list[str]:
    return [view for view in a.psnr if view in b.psnr]


Rows = list[dict[str, str | Link]]


def _options(a: ReportRun, b: ReportRun) -> tuple[Rows, Rows]:
    """The options that differ, by their full names; apart, those of plugins of which the other run
    has another."""
    one, other = (flatten(run.record.config) for run in (a, b))
    groups = {group for group in METHOD_GROUPS if _named(one, group) != _named(other, group)}
    rows: Rows = []
    inner: Rows = []
    for key in sorted(one.keys() | other.keys()):
        values = [text_of(own[key]) if key in own else "" for own in (one, other)]
        if key not in UNTOLD and values[0] != values[1]:
            group, _, option = key.partition(".")
            place = inner if group in groups and option != "name" else rows
            place.append({"Option": outside(key), **_cells(a, b, values)})
    return rows, inner


def _named(flat: Mapping[str, object], group: str) -> object:
    return flat.get(f"{group}.name")


def _cells(a: ReportRun, b: ReportRun, values: Sequence[str]) -> dict[str, str]:
    return {a.method: values[0], b.method: values[1]}


def _views(a: ReportRun, b: ReportRun) -> list[dict[str, str]]:
    """PSNR of both on every common view with its difference, and the other metrics."""
    shown = ("psnr", "ssim", "flip", "lpips", AVERAGE)
    metrics = [m for m in shown if any(run.mean(m) is not None for run in (a, b))]
    columns = [{m: _column(run, m) for m in metrics} for run in (a, b)]
    rows = []
    for view in _common(a, b):
        row = {"View": outside(view)}
        for metric in metrics:
            one, other = (own[metric].get(view, math.nan) for own in columns)
            for run, value in ((a, one), (b, other)):
                row[f"{heading_of(metric)}, {run.method}"] = _text(value, digits(metric))
            if metric == "psnr":
                row["difference (dB)"] = (
                    signed(one - other) if math.isfinite(one - other) else ABSENT
                )
        rows.append(row)
    return rows


def _column(run: ReportRun, metric: str) -> Mapping[str, float]:
    found = run.run.metrics
    if metric not in found.numbers:
        return {}
    return dict(zip(found.texts["view"], found.numbers[metric].tolist(), strict=True))


def _text(value: float, places: int) -> str:
    return f"{value:.{places}f}" if math.isfinite(value) else ABSENT


def _curves(study: Study) -> Picture | None:
    given = looks([run.method for run in study.runs])
    series = tuple(
        Series(
            run.method,
            given[run.method],
            tuple(Point(x, y, y, y, f"step {step}") for step, (x, y) in evaluations(run).items()),
        )
        for run in study.runs
        if evaluations(run)
    )
    if not series:
        return None
    label = "training time (s, wall clock, without evaluation)"
    chart = Chart("curves", "", label, "test PSNR (dB)", series, min_span=MIN_SPAN_DB)
    return chart_picture(study.out_dir, (chart,), "Quality over training time of both", CURVES)


def _facts(study: Study) -> list[dict[str, str | Link]]:
    facts = {
        "Training, wall (s)": [_text(r.record.train_s or math.nan, 1) for r in study.runs],
        "Training, CPU (s)": [_text(r.record.train_cpu_s or math.nan, 1) for r in study.runs],
        "Gaussians": [f"{r.record.gaussians:,}" for r in study.runs],
        "Parameters": [f"{r.record.parameters:,}" for r in study.runs],
        "PLY (kB)": [f"{r.record.ply_bytes / 1000:,.0f}" for r in study.runs],
        "Bits of the parameters": [r.record.parameters_sha256[:12] for r in study.runs],
        "Code": [code_of(r.record.provenance) for r in study.runs],
        "Run": [outside(study.folder_of(r.run.run_dir)) for r in study.runs],
    }
    a, b = study.runs
    return [{"What": name, **_cells(a, b, values)} for name, values in facts.items()]


def main(arguments: list[str], prog: str) -> int:
    """The subcommand; exit status 0. Raises UserError for bad input."""
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
    path = compare_runs(first, second, options.out)
    print(f"compared: {printable_line(str(path))}")
    return 0
