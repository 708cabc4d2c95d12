"""For those who go on elsewhere: `runs.csv`, one row per complete run, and `comparisons.tex`, every
comparison as a LaTeX table."""

from __future__ import annotations

from typing import Any

from framework.metrics.values import METRICS
from framework.records.archive import Entry, archive
from framework.records.provenance import NEUTRAL_KEYS
from framework.records.record import Run, RunRecord
from framework.records.run_files import Table
from framework.report.statistics.compare import Comparison
from framework.report.statistics.estimates import Interval
from framework.report.statistics.numbers import interval_text, p_text, signed
from framework.report.statistics.outcomes import Outcomes
from framework.report.study.axes import VIEWS
from framework.report.study.defaults import with_defaults
from framework.report.study.labels import flatten, outside
from framework.report.study.runs import FailedRun, ReportRun, Study
from framework.report.text.provenance import code_of

TABLE, LATEX = "runs.csv", "comparisons.tex"
ALSO, DOSE = "also.", "dose."  # begin the columns of plugins' metrics and of what the method did
ESCAPES = {
    **{character: f"\\{character}" for character in "&%$#_{}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{"<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", "°": r"\textdegree{}"},
}


def runs_archive(study: Study) -> str:
    """All runs of the study, complete and failed, as `framework.records.archive` describes."""
    failed = [run for run in study.failed if "seed" in run.config]  # others left no record
    entries = [Entry(run.run) for run in study.runs]
    return archive([*entries, *map(_failed_entry, failed)])


def _failed_entry(run: FailedRun) -> Entry:
    record = RunRecord(
        identity="",
        config=run.config,
        overrides=run.overrides,
        scene=None,
        timings={},
        provenance=run.provenance,
        status="failed",
        error=run.error,
    )
    empty = Table({}, {})
    return Entry(Run(run.run_dir, record, empty, empty), run.kind, run.again)


def runs_csv(study: Study) -> str:
    """The study as a tidy table, in the report's order: labels, seed, every option that differs
    between its runs (by its full name), mean metrics over the test views, size and seconds. A
    value that is missing is an empty cell."""
    import pandas as pd

    measured = pd.DataFrame([_measured(run) for run in study.runs])
    told = with_defaults([flatten(run.record.config) for run in study.runs])
    options = pd.DataFrame(told).drop(columns=["seed", *NEUTRAL_KEYS], errors="ignore")
    # an option that only some methods have differs too
    if VIEWS in options:  # `all` of them by their number, as a table has no scene to count in
        counted = [run.scene_label.data.get(VIEWS) for run in study.runs]
        options[VIEWS] = [
            n if n is not None else v for n, v in zip(counted, options[VIEWS], strict=True)
        ]
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
        **{f"{ALSO}{name}": run.mean(name) for name in run.record.summary if name not in METRICS},
        **{f"{DOSE}{outside(name)}": _plain(value) for name, value in record.dose.items()},
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


def _plain(value: object) -> object:
    """A dose's number or text; None stays None, which is an empty cell."""
    return outside(value) if isinstance(value, str) else value


def comparisons_tex(found: Outcomes) -> str:
    """A `tabular` of every comparison: over these scenes and over scenes like these (corrected for
    all methods), and on every scene alone (uncorrected). Needs no package."""
    lines = [
        r"\begin{tabular}{lllrrlr}",
        r"\hline",
        r"Method & Against & On & $n$ & $\Delta$PSNR (dB) & 95\,\% interval & $p$ \\",
        r"\hline",
    ]
    for method, c in found.comparisons.items():
        where = "these scenes" if len(c.scenes) > 1 else "the scene"
        lines.append(_tex(c, where, c.n, c.difference, c.joint, c.p_joint))
        if c.like is not None:
            p = None if c.like.p is None else min(1.0, c.tests * c.like.p)
            like = c.like_joint
            lines.append(_tex(c, "scenes like these", c.like.n, c.like.mean, like, p))
        for scene, compared in found.by_scene.items():
            if method in compared:
                own = compared[method]
                lines.append(_tex(own, scene, own.n, own.difference, own.interval, own.p))
        lines.append(r"\hline")
    return "\n".join([*lines, r"\end{tabular}", ""])


def _tex(
    c: Comparison, on: str, n: int, difference: float, interval: Interval | None, p: float | None
) -> str:
    inside = "--" if interval is None else interval_text(interval)
    chance = "--" if p is None else p_text(p).removeprefix("p ").removeprefix("= ")
    words = [c.method, c.baseline, on, str(n), signed(difference), inside, chance]
    return " & ".join(_escaped(word) for word in words) + r" \\"


def _escaped(text: str) -> str:
    """Text from outside as LaTeX prints it; numbers with a true minus sign."""
    plain = "".join(ESCAPES.get(character, character) for character in text)
    is_number = text[:1] in "+-" and text[1:2].isdigit()
    return plain.replace("-", "$-$").replace("+", "$+$") if is_number else plain
