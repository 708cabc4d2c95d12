"""Read the runs of a study and compare its methods."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fishersplat.arguments import expect_folder
from framework.report.study.study import ReportRun

METRICS = ("psnr", "ssim", "flip", "lpips", "lpips_01")
COMPARED = ("method", "baseline", "difference", "low", "high", "p", "significant", "n")


@dataclass(frozen=True)
class Study:
    """The completed runs of a study.

    Attributes:
        folder: the folder that `load_study` read.
        runs: one row per run, with `method`, `scene`, `seed`, `gaussians` and `folder`. Metrics
            are means over the test views (`psnr` in dB). `train_s` and `train_cpu_s` are seconds.
    """

    folder: Path
    runs: pd.DataFrame

    def comparisons(self, baseline: str = "") -> pd.DataFrame:
        """Compare all methods with the baseline, as the report does.

        Args:
            baseline: display or registry name of a method; by default training without a method.

        Returns:
            One row per method: `difference` of PSNR in dB, whether it is `significant`, and `n`
            seeds. Its 95 % confidence interval `low` to `high` and `p` are Bonferroni-corrected for
            all rows. Missing values where single runs allow no interval.

        Raises:
            UserError: No method has that name.
        """
        from framework.report.findings import find
        from framework.report.study.collect import collect

        findings = find(collect(self.folder, rival=baseline))
        rows = []
        for comparison in findings.outcomes.comparisons.values():
            interval = comparison.joint
            row = {
                "method": comparison.method.name,
                "baseline": comparison.baseline.name,
                "difference": comparison.difference,
                "low": None if interval is None else interval.low,
                "high": None if interval is None else interval.high,
                "p": comparison.p_joint,
                "significant": comparison.significant,
                "n": comparison.n,
            }
            rows.append(row)
        return pd.DataFrame(rows, columns=list(COMPARED))


def load_study(path: Path | str) -> Study:
    """Read a study.

    Args:
        path: a folder such as `reports/STUDY`, with the folders of its runs or a `runs.jsonl`.

    Raises:
        UserError: The folder has no completed runs.
    """
    from framework.report.study.collect import collect

    folder = expect_folder("load_study", path, "reports/STUDY")
    collected = collect(folder)
    return Study(folder, pd.DataFrame(map(dict, map(_row, collected.runs))))


def _row(run: ReportRun) -> Iterator[tuple[str, Any]]:
    """The columns of a run."""
    yield from (("method", run.method.name), ("scene", run.scene), ("seed", run.seed))
    yield from ((name, run.mean(name)) for name in METRICS)
    record = run.record
    yield from (("gaussians", record.gaussians), ("train_s", record.train_s))
    yield from (("train_cpu_s", record.train_cpu_s), ("folder", str(run.run.run_dir)))
