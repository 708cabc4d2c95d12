"""`runs.csv`: one row per complete run, for those who go on in a notebook or a spreadsheet."""

from __future__ import annotations

from typing import Any

from framework.metrics.values import METRICS
from framework.report.study.collect import ReportRun, Study

TABLE = "runs.csv"


def runs_csv(study: Study) -> str:
    """The study as a tidy table, in the report's order: labels, seed, every option that differs
    between its runs (by its full name), mean metrics over the test views, size and seconds. A
    value that is missing is an empty cell."""
    import pandas as pd

    measured = pd.DataFrame([_measured(run) for run in study.runs])
    options = pd.json_normalize([dict(run.record.config) for run in study.runs]).drop(
        columns=["seed", "study", "force", "estimate", "traceback", "threads"], errors="ignore"
    )
    # an option that only some methods have differs too
    differs = [name for name in options if options[name].map(repr).nunique() > 1]
    labels = ["scene", "method", "seed"]
    # one column stays one column: `method` is a label here, never an option
    chosen = options[differs].drop(columns=labels, errors="ignore")
    table = pd.concat([measured[labels], chosen, measured.drop(columns=labels)], axis=1)
    return str(table.to_csv(index=False, lineterminator="\n"))


def _measured(run: ReportRun) -> dict[str, Any]:
    record = run.record
    return {
        "scene": run.scene,
        "method": run.method,
        "seed": run.seed,
        **{metric: run.mean(metric) for metric in METRICS},
        "gaussians": record.gaussians,
        "parameters": record.parameters,
        "train_wall_s": record.train_s,
        "train_cpu_s": record.train_cpu_s,
        "run": run.run.run_dir.name,
    }
