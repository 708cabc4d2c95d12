"""For further use: `runs.csv`, one row per complete run; `runs.jsonl`, the archive; and the table
for a paper, `results` as LaTeX (package booktabs), Markdown and CSV."""

from collections.abc import Mapping
from typing import Any

from framework.metrics.values import METRICS
from framework.records.archive import Entry, archive
from framework.records.provenance import NEUTRAL_KEYS
from framework.records.run_files import csv_text
from framework.report.provenance import code_of
from framework.report.render import columns, pipe_table, tex
from framework.report.study.axes import VIEWS
from framework.report.study.methods import Method, learned_footnote
from framework.report.study.plugins import with_defaults
from framework.report.study.study import ReportRun, Study
from framework.report.study.words import flatten, outside
from framework.report.tables import Result, heading_of, results_rows

TABLE, RESULTS = "runs.csv", "results"
ALSO, DOSE = "also.", "dose."  # begin the columns of plugins' metrics and of what the method did
Results = Mapping[Method, Mapping[str, Result | None]]


def runs_archive(study: Study) -> str:
    """All runs of the study, complete and failed, as `framework.records.archive` describes."""
    failed = [run for run in study.failed if run.seed is not None]  # others left no record
    return archive([*(Entry(run.run) for run in study.runs), *failed])


def runs_csv(study: Study) -> str:
    """The study as a tidy table, in the report's order.

    Columns are labels, seed, every option that differs between its runs (by its full name), mean
    metrics over the test views, size and seconds. A missing value is an empty cell.
    """
    measured = [_measured(run) for run in study.runs]
    options = [dict(c) for c in with_defaults([flatten(run.record.config) for run in study.runs])]
    for run, chosen in zip(study.runs, options, strict=True):
        counted = run.scene_label.data.get(VIEWS)
        if VIEWS in chosen and counted is not None:  # `all` of them as their number
            chosen[VIEWS] = counted
    # `method` and `scene` are labels here, never options
    left_out = {"seed", "scene", "method", *NEUTRAL_KEYS}
    names = [name for name in columns(options) if name not in left_out]
    differs = [
        name for name in names if len({repr(row_options.get(name)) for row_options in options}) > 1
    ]
    labels = ["scene", "method", "seed"]
    heads = [*labels, *differs, *(name for name in columns(measured) if name not in labels)]
    rows = [{**chosen, **row} for chosen, row in zip(options, measured, strict=True)]
    return csv_text(rows, heads)


def _measured(run: ReportRun) -> dict[str, Any]:
    record = run.record
    return {
        "scene": run.scene,
        "method": run.method.label,
        "seed": run.seed,
        **{metric: run.mean(metric) for metric in METRICS},
        **{f"{ALSO}{name}": run.mean(name) for name in record.summary if name not in METRICS},
        **{
            f"{DOSE}{outside(name)}": outside(value) if isinstance(value, str) else value
            for name, value in record.dose.items()
        },
        "gaussians": record.gaussians,
        "parameters": record.parameters,
        "train_wall_s": record.train_s,
        "train_cpu_s": record.train_cpu_s,
        "ply_bytes": record.ply_bytes,
        "parameters_sha256": record.parameters_sha256[:12],
        "protocol": outside(run.protocol),
        "code": code_of(record.provenance),
        "cpu": run.machine,
        "overrides": outside(" ".join(w for w in record.overrides if not w.startswith("seed="))),
        "run": outside(run.run.run_dir.name),
    }


def results_files(results: Results) -> dict[str, str]:
    """Name -> content of the table of results in three forms."""
    metrics = list(next(iter(results.values())))
    footnote = learned_footnote(results)
    context = {"results": results, "metrics": metrics, "footnote": footnote}
    return {
        f"{RESULTS}.tex": tex("results.tex.jinja", **context, heading_of=heading_of),
        f"{RESULTS}.md": f"{pipe_table(results_rows(results))}\n\n{footnote}".strip() + "\n",
        f"{RESULTS}.csv": _results_csv(results),
    }


def _results_csv(results: Results) -> str:
    rows = []
    for method, cells in results.items():
        row = {"method": method.name}
        for metric, result in cells.items():
            row |= {metric: result.text if result else ""}
            row |= {f"{metric}_sigma": result.sigma_text if result else ""}
        rows.append(row)
    return csv_text(rows)
